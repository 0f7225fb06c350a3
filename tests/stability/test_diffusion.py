"""Schedules, samplers and distillation: both ends of the noise, strong guidance, hard masks, priors that break."""

import math

import pytest
import torch

from inpaint3d.contracts.errors import BadInputError, NonFiniteError
from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion import distillation
from inpaint3d.diffusion.denoiser import guide_noise
from inpaint3d.diffusion.distillation import PriorQuery
from inpaint3d.diffusion.fill import pyramid_fill
from inpaint3d.diffusion.io import load_prior, save_prior
from inpaint3d.diffusion.judging import hole_psnr
from inpaint3d.diffusion.parameterisation import Kind, Parameterisation
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.samplers import ddim, ddpm, dpm_solver, inpaint, uniform_times
from inpaint3d.diffusion.schedules import alpha, cosine_log_snr, linear_log_snr, shifted_log_snr, sigma
from inpaint3d.diffusion.training import begin, check_finite_weights, load_checkpoint, save_checkpoint, train_step
from tests.stability.catalogue import hard_case

SCHEDULES, PRIORS, HOLES = "Schedules", "Priors", "Holes"
SPEC = PriorSpec.model_validate({
    "size": 16, "width": 8, "multipliers": (1,), "blocks": (1,), "attention": (False,), "residual_bands": (0.3,),
    "residual_colours": (1.0, 1.0, 1.0), "packing": 2, "condition": "mask-channel", "known": "clean",
    "loss_region": "hole", "prediction": "residual",
})  # fmt: skip
GRADIENTS = ["sds_gradient", "nfsd_gradient", "sdi_gradient", "ism_gradient", "denoised_target_gradient"]
MASKS = {
    "empty": lambda m: m, "one-pixel": lambda m: m.index_put_((torch.tensor(0), torch.tensor(0), torch.tensor(8),
    torch.tensor(8)), torch.tensor(1.0)), "line": lambda m: m[:, :, 8].fill_(1), "full": lambda m: m.fill_(1),
}  # fmt: skip


def mask_of(kind: str) -> torch.Tensor:
    mask = torch.zeros(1, 1, 16, 16)
    MASKS[kind](mask)
    return mask


class Breaking:
    """A prior over pixels that answers one number that breaks, at one of its calls or at each."""

    size, latent_shape, bound = 16, (3, 16, 16), 1.0

    def __init__(self, value: float, at: int | None = None, decoded: float = 1.0) -> None:
        self.value, self.at, self.decoded = value, at, decoded
        self.times: list[float] = []

    def encode(self, image: torch.Tensor) -> torch.Tensor:
        return image * 1.0

    def decode(self, latent: torch.Tensor) -> torch.Tensor:
        return latent * self.decoded

    def predict_noise(self, z, t, image, mask, *, guidance=1.0, noise_fill=None):
        answer = torch.zeros_like(z)
        if self.at is None or self.at == len(self.times):
            answer[0, 0, 8, 8] = self.value
        self.times.append(float(t))
        return answer


@hard_case(
    SCHEDULES,
    plain="log tan is infinite at t = 0 and 1, its gradient NaN; 1 - alpha^2 is 0 in float32",
    ours="t is clamped where the log SNR reaches +-20, sigma is a sigmoid of its own",
    swept="t of 0, 1e-30 to 1; alpha^2 + sigma^2 = 1 to 1e-6, both above 4e-5, finite gradients",
)
@pytest.mark.parametrize("t", [0.0, 1e-30, 1e-8, 1e-4, 0.5, 1 - 1e-4, 1.0])
@pytest.mark.parametrize("schedule", ["cosine", "linear", "shifted"])
def test_schedules_at_both_ends(t: float, schedule: str) -> None:
    time = torch.tensor([t], requires_grad=True)
    snr = {"cosine": cosine_log_snr, "linear": linear_log_snr, "shifted": lambda x: shifted_log_snr(x, 256)}[schedule]
    found = snr(time)
    found.backward()
    assert found.abs() <= 20
    assert time.grad is not None
    assert time.grad.isfinite()
    a, s = alpha(time.detach()), sigma(time.detach())
    assert float(a**2 + s**2) == pytest.approx(1, rel=1e-6)
    assert min(float(a), float(s)) > 4e-5


@hard_case(
    SCHEDULES,
    plain="(z - s eps) / a and (z - a x) / s blow up at the ends",
    ours="neither level falls below 4.5e-5",
    swept="t of 0, 1e-4, 0.5, 1 for eps, x0, v: clean and noise of the exact output come back",
)
@pytest.mark.parametrize("t", [0.0, 1e-4, 0.5, 1 - 1e-4, 1.0])
@pytest.mark.parametrize("kind", ["eps", "x0", "v"])
def test_parameterisations_are_exact(t: float, kind: Kind) -> None:
    generator = torch.Generator().manual_seed(0)
    x, eps = (torch.randn(1, 3, 4, 4, generator=generator, dtype=torch.float64) for _ in range(2))
    p = Parameterisation(kind, torch.tensor([t], dtype=torch.float64))
    a, s = p.levels
    z = a * x + s * eps
    output = p.target(x, eps, x)
    torch.testing.assert_close(p.clean(output, z, x), x, rtol=1e-6, atol=1e-9)
    torch.testing.assert_close(p.noise(output, z, x), eps, rtol=1e-6, atol=1e-9)


@hard_case(
    SCHEDULES,
    plain="inversion and sampling divide by alpha and sigma at every step",
    ours="levels are bounded, and each step is exact for a linear denoiser",
    swept="1 to 32 steps of DDIM there and back, t up to 0.95; within 1e-3 of the picture",
)
@pytest.mark.parametrize("steps", [1, 4, 32])
@pytest.mark.parametrize("top", [0.2, 0.95])
def test_ddim_comes_back(steps: int, top: float) -> None:
    x = torch.rand(1, 3, 4, 4, generator=torch.Generator().manual_seed(0)) * 2 - 1

    def predict(z: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
        return 0.1 * torch.ones_like(z)

    up = torch.linspace(0.02, top, steps + 1)
    noised = ddim(predict, x, up)
    torch.testing.assert_close(ddim(predict, noised, up.flip(0)), x, rtol=0, atol=1e-3)


@hard_case(
    PRIORS,
    plain="eps_null + g (eps_cond - eps_null) grows with g: 100 times what cancels in the difference",
    ours="clean estimates are bounded where pictures are; equal conditions give the estimate itself",
    swept="guidance of 0, 1, 2, 8, 100, -5",
)
@pytest.mark.parametrize("guidance", [0.0, 1.0, 2.0, 8.0, 100.0, -5.0])
def test_guidance(guidance: float) -> None:
    same = torch.full((1, 3, 2, 2), 0.3)
    torch.testing.assert_close(guide_noise(lambda: same, lambda: same, guidance), same)
    prior, mask = InpaintingPrior(SPEC), mask_of("line")
    made = inpaint(
        prior, torch.zeros(1, 3, 16, 16), mask, steps=2, generator=torch.Generator().manual_seed(0), guidance=guidance
    )
    assert made.abs().max() <= 1


@hard_case(
    PRIORS,
    plain="clamp(inf) is 1 and clamp(NaN) reaches every later step: a broken prior paints white",
    ours="an answer is looked at before it is bounded",
    swept="NaN, inf, -inf in one number; five estimators, three samplers",
    told="`step N, view NAME, window ...: the prior answered COUNT of TOTAL numbers that are not finite at diffusion "
    "time T; take another prior ...` (exit code 3)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("ask", [*GRADIENTS, "vsd_gradient", "ddim", "ddpm", "dpm-solver"])
def test_a_prior_that_breaks(value: float, ask: str) -> None:
    generator, x = torch.Generator().manual_seed(0), torch.zeros(1, 3, 16, 16)
    query = PriorQuery(x, mask_of("line"), torch.tensor([0.5]), torch.randn(1, 3, 16, 16, generator=generator))

    def ask_it() -> torch.Tensor:
        if ask == "vsd_gradient":
            return distillation.vsd_gradient(Breaking(0.0), Breaking(value), query)
        if ask in GRADIENTS:
            return getattr(distillation, ask)(Breaking(value), query)
        return inpaint(Breaking(value), x, query.mask, steps=2, generator=generator, sampler=ask)  # pyright: ignore[reportArgumentType]

    with pytest.raises(BadInputError, match=r"answered 1 of 768 numbers that are not finite at diffusion time [01]\."):
        ask_it()


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_no_call_of_a_prior_goes_unseen(gradient: str) -> None:
    query = PriorQuery(torch.zeros(1, 3, 16, 16), mask_of("line"), torch.tensor([0.03]), torch.zeros(1, 3, 16, 16))
    sound = Breaking(0.0)
    getattr(distillation, gradient)(sound, query)
    assert min(sound.times) >= min(distillation.T_FLOOR, 0.03 / 4) - 1e-6
    if gradient == "ism_gradient":
        assert min(sound.times) >= distillation.T_FLOOR - 1e-6
    for call in range(len(sound.times)):
        with pytest.raises(BadInputError, match="not finite at diffusion time"):
            getattr(distillation, gradient)(Breaking(math.inf, call), query)


@pytest.mark.parametrize("value", [math.nan, math.inf, 1e6])
def test_what_a_decoder_makes_is_looked_at_and_bounded(value: float) -> None:
    x, mask, generator = torch.full((1, 3, 16, 16), 0.1), mask_of("line"), torch.Generator().manual_seed(0)
    query = PriorQuery(x, mask, torch.tensor([0.5]), torch.zeros(1, 3, 16, 16))
    broken = Breaking(0.0, decoded=value)
    for ask in (
        lambda: distillation.denoised_target(broken, query),
        lambda: inpaint(broken, x, mask, steps=2, generator=generator),
    ):
        if math.isfinite(value):
            assert ask().abs().max() <= 1
        else:
            with pytest.raises(BadInputError, match="not finite"):
                ask()


def test_smoothing_without_a_known_pixel_is_nothing() -> None:
    smooth = distillation._smooth(torch.ones(1, 3, 16, 16), mask_of("full"))  # no query shows it
    assert (smooth == 0).all()


@pytest.mark.parametrize("t", [1e-6, 1e-5, 1e-4, 1e-3])
def test_the_linear_schedule_keeps_its_digits_near_the_picture(t: float) -> None:
    time = torch.tensor([t])
    exact = linear_log_snr(time.double(), clamp=60.0)
    torch.testing.assert_close(linear_log_snr(time, clamp=60.0).double(), exact, rtol=1e-6, atol=0)


@hard_case(
    HOLES,
    plain="means over a hole of no pixel, condition without a known one: 0 / 0",
    ours="fills of nothing are mid grey; gradients are 0 outside the hole",
    swept="empty, one-pixel, line and full masks; five estimators; t of 0.02 and 1",
)
@pytest.mark.parametrize("kind", list(MASKS))
@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("t", [0.02, 1.0])
def test_distillation_of_hard_masks(kind: str, gradient: str, t: float) -> None:
    prior, mask = InpaintingPrior(SPEC), mask_of(kind)
    x = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(1)) * 2 - 1
    eps = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(2))
    found = getattr(distillation, gradient)(prior, PriorQuery(x, mask, torch.tensor([t]), eps), guidance=8.0)
    assert found.isfinite().all()
    assert (found * (1 - mask) == 0).all()
    # Under a full mask both conditions of nfsd and ism are the same, and nothing is left between them.
    if kind != "full":
        assert bool((found != 0).any()) == (kind != "empty")


@hard_case(
    HOLES,
    plain="what lies under a mask leaks: 0 * NaN is NaN",
    ours="chosen by where, never multiplied",
    swept="NaN, inf and 1e30 under one-pixel, line and full masks",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e30])
@pytest.mark.parametrize("kind", ["one-pixel", "line", "full"])
def test_nothing_leaks_from_under_a_mask(value: float, kind: str) -> None:
    mask = mask_of(kind)
    image = torch.where(mask > 0, value, 0.25).expand(1, 3, 16, 16)
    filled = pyramid_fill(image, mask)
    expected = 0.0 if kind == "full" else 0.25
    torch.testing.assert_close(filled, torch.full_like(filled, expected), rtol=1e-6, atol=0)


@hard_case(
    PRIORS,
    plain="a sum of 1e6 bfloat16 numbers forgets most of them; a small share of half precision overflows",
    ours="weights, inputs, outputs, levels and losses stay float32: the network alone runs in bfloat16",
    swept="bf16 and fp32 at t of 0, 0.02, 0.5, 1: finite, within 2 % of each other",
)
@pytest.mark.parametrize("t", [0.0, 0.02, 0.5, 1.0])
def test_bf16_estimates(t: float) -> None:
    image = torch.rand(1, 3, 16, 16, generator=torch.Generator().manual_seed(1)) * 2 - 1
    z = torch.randn(1, 3, 16, 16, generator=torch.Generator().manual_seed(2))
    time, mask = torch.tensor([t]), mask_of("line")
    plain, half = (InpaintingPrior(SPEC, bf16=bf16).estimate(z, time, image, mask) for bf16 in (False, True))
    for a, b in zip((plain.clean, plain.noise), (half.clean, half.noise), strict=True):
        a, b = a.detach(), b.detach()
        assert b.isfinite().all()
        assert float((a - b).abs().max()) <= 0.02 * max(float(a.abs().max()), 1.0)


def _losses(prior: InpaintingPrior, value: float) -> torch.Tensor:
    return sum((p.square().sum() for p in prior.parameters()), torch.zeros(())) * value


@hard_case(
    PRIORS,
    plain="a step of NaN gradients makes every weight NaN",
    ours="it changes nothing, is counted and located; the third in a row stops the training",
    swept="NaN, inf; gradients of 1e30, whose norm overflows",
    told="`step N of the prior's training was not finite: TENSOR (COUNT, ...)`; the third in a row: exit code 1",
)
@pytest.mark.parametrize("bf16", [False, True])
@pytest.mark.parametrize("value", [math.nan, math.inf, 1e30])
def test_a_broken_step_of_training_moves_nothing(value: float, bf16: bool) -> None:
    state = begin(SPEC, 0, bf16=bf16)
    before = [p.detach().clone() for p in state.prior.parameters()]
    assert math.isnan(train_step(state, lambda prior: _losses(prior, value), learning_rate=1e-3))
    assert state.step == 1
    assert all(torch.equal(a, b) for a, b in zip(before, state.prior.parameters(), strict=True))
    gradients = [p.grad for p in state.prior.parameters()]
    # They are as they came, so that the error can name those that broke.
    assert not all(g is None or g.isnan().all() for g in gradients) or math.isnan(value)


@hard_case(
    PRIORS,
    plain="a NaN in the average of the weights is what is used afterwards",
    ours="weights, averages and moments are looked at before every checkpoint and commit",
    swept="NaN and inf in weight, average and moment; float16 overflow of 1e5 in files that travel",
    told="`the prior is not finite after step N: TENSOR (COUNT, the first at [...])` (exit code 1)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("part", ["prior", "average", "moment"])
def test_a_broken_prior_is_never_kept(tmp_path, value: float, part: str) -> None:
    state = begin(SPEC, 0)
    train_step(state, lambda prior: _losses(prior, 1.0), learning_rate=1e-3)
    save_checkpoint(tmp_path / "c.safetensors", state)
    weight = next(state.prior.parameters())
    broken = {
        "prior": weight,
        "average": next(state.average.parameters()),
        "moment": state.optimiser.state[weight]["exp_avg_sq"],
    }[part]
    with torch.no_grad():
        broken.view(-1)[0] = value
    with pytest.raises(NonFiniteError, match=r"not finite after step 1: .* \(1, the first at \[0"):
        save_checkpoint(tmp_path / "c.safetensors", state)
    assert load_checkpoint(tmp_path / "c.safetensors", begin(SPEC, 0))


def test_a_prior_that_overflows_half_precision_is_not_written(tmp_path) -> None:
    prior = InpaintingPrior(SPEC)
    with torch.no_grad():
        next(prior.parameters()).view(-1)[0] = 1e5
    save_prior(tmp_path / "whole", prior)
    load_prior(tmp_path / "whole", SPEC)
    with pytest.raises(NonFiniteError):
        save_prior(tmp_path / "half", prior, half=True)
    check_finite_weights(prior.state_dict())


@hard_case(
    HOLES,
    plain="log10(0) of equal pictures; 0 / 0 of no hole",
    ours="equal pictures are infinite, and kept out of means; no hole is NaN, not a score",
    swept="equal, 1e-10 to 2 apart, NaN",
)
@pytest.mark.parametrize("apart", [0.0, 1e-10, 1e-3, 2.0, math.nan])
def test_psnr_of_a_hole(apart: float) -> None:
    truth = torch.zeros(1, 3, 16, 16)
    found = float(hole_psnr(truth + apart, truth, mask_of("line")))
    if math.isnan(apart):
        assert math.isnan(found)
    else:
        assert found == pytest.approx(10 * math.log10(4 / apart**2) if apart else math.inf, rel=1e-5)
    assert math.isnan(float(hole_psnr(truth, truth, mask_of("empty"))))


@hard_case(
    SCHEDULES,
    plain="the last leap to t = 0 divides by the SNR of almost no noise",
    ours="bounded levels, first order at both ends",
    swept="1, 2 and 16 steps of three samplers from noise of 1 and of 1e4",
)
@pytest.mark.parametrize("sampler", ["ddim", "ddpm", "dpm-solver"])
@pytest.mark.parametrize("steps", [1, 2, 16])
@pytest.mark.parametrize("size", [1.0, 1e4])
def test_samplers_stay_bounded(sampler: str, steps: int, size: float) -> None:
    z = size * torch.randn(1, 3, 4, 4, generator=torch.Generator().manual_seed(0))
    solve = {"ddim": ddim, "dpm-solver": dpm_solver, "ddpm": ddpm}[sampler]
    given = {"generator": torch.Generator().manual_seed(1)} if sampler == "ddpm" else {}
    made = solve(lambda z, t: torch.zeros_like(z), z, uniform_times(steps), clip=1.0, **given)
    assert made.isfinite().all()
    assert made.abs().max() <= 1.01 if size == 1 else made.abs().max() < size
