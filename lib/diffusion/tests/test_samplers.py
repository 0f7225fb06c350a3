import pytest
import torch

from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.samplers import ddim, ddpm, dpm_solver, inpaint, uniform_times
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

MEAN, SPREAD = 0.4, 0.25


def gaussian(z: torch.Tensor, t: torch.Tensor) -> torch.Tensor:
    """The exact eps_hat where the pictures are N(MEAN, SPREAD^2)."""
    a, s = per_image(alpha(t)).to(z), per_image(sigma(t)).to(z)
    return s * (z - a * MEAN) / (a**2 * SPREAD**2 + s**2)


def test_ddim_carries_each_noise_to_its_quantile() -> None:
    """The probability flow of a Gaussian is linear: z at t = 1 ends at MEAN + SPREAD * z."""
    z = torch.randn(4, 3, 8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    ends = {steps: ddim(gaussian, z, uniform_times(steps)) for steps in (50, 100, 400)}
    errors = [(end - (MEAN + SPREAD * z)).abs().max().item() for end in ends.values()]
    assert errors[2] < 0.01
    # First order: four times the steps, about a quarter of the error.
    assert errors[2] < errors[1] / 3


def test_ddim_from_a_level_of_its_own_for_each_picture() -> None:
    z = torch.randn(2, 3, 8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    t = torch.tensor([0.3, 0.7], dtype=torch.float64)
    both = ddim(gaussian, z, torch.linspace(1, 0, 31)[:, None].double() * t)
    for i in (0, 1):
        alone = ddim(gaussian, z[i : i + 1], uniform_times(30, start=t[i].item()))
        # The times of the second are single precision.
        torch.testing.assert_close(both[i : i + 1], alone, rtol=0, atol=1e-5)


def test_ddpm_draws_from_the_gaussian() -> None:
    generator = torch.Generator().manual_seed(0)
    z = torch.randn(16, 3, 32, 32, generator=generator)
    x = ddpm(gaussian, z, uniform_times(200), generator=generator)
    # 49,152 samples: the mean is known to 0.0011 and the spread to 0.0008; 200 steps bias the spread by under 0.005.
    assert x.mean().item() == pytest.approx(MEAN, abs=0.005)
    assert x.std().item() == pytest.approx(SPREAD, abs=0.008)


def test_ddpm_forgets_where_it_started_and_ddim_does_not() -> None:
    z = torch.randn(8, 3, 16, 16, generator=torch.Generator().manual_seed(0))
    ancestral = ddpm(gaussian, z, uniform_times(100), generator=torch.Generator().manual_seed(1))
    flow = ddim(gaussian, z, uniform_times(100))
    assert abs(torch.corrcoef(torch.stack([z.flatten(), ancestral.flatten()]))[0, 1]) < 0.1
    assert torch.corrcoef(torch.stack([z.flatten(), flow.flatten()]))[0, 1] > 0.999


def _flow(z: torch.Tensor, start: float, end: float) -> torch.Tensor:
    """Where the Gaussian's probability flow carries z from t = start to t = end, exactly."""
    a, s = alpha(torch.tensor([start, end]).double()), sigma(torch.tensor([start, end]).double())
    spread = (a**2 * SPREAD**2 + s**2).sqrt()
    return a[1] * MEAN + spread[1] / spread[0] * (z - a[0] * MEAN)


def test_dpm_solver_is_of_second_order_and_ddim_of_first() -> None:
    z = torch.randn(2, 3, 8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    exact = _flow(z, 0.9, 0.2)
    times = {steps: torch.linspace(0.9, 0.2, steps + 1, dtype=torch.float64) for steps in (20, 40, 80)}
    for solve, factor in ((ddim, 2), (dpm_solver, 4)):
        errors = [(solve(gaussian, z, t) - exact).abs().max().item() for t in times.values()]
        assert errors[0] / errors[1] == pytest.approx(factor, rel=0.15)
        assert errors[1] / errors[2] == pytest.approx(factor, rel=0.15)
    assert errors[2] < 1e-3


def test_dpm_solver_gets_nearer_to_the_picture_in_as_many_calls_as_ddim() -> None:
    """All the way from noise, where the first and the last step leap in lambda."""
    z = torch.randn(2, 3, 8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    errors = {
        (solve, steps): (solve(gaussian, z, uniform_times(steps)) - (MEAN + SPREAD * z)).abs().max().item()
        for solve in (ddim, dpm_solver)
        for steps in (10, 20)
    }
    assert errors[dpm_solver, 10] < errors[ddim, 10]
    assert errors[dpm_solver, 20] < errors[ddim, 20] / 2


def test_dpm_solver_bounds_its_clean_estimates() -> None:
    z = torch.full((1, 3, 4, 4), 9.0)
    assert dpm_solver(gaussian, z, uniform_times(8), clip=0.5).max() <= 0.5 + 1e-3
    assert dpm_solver(gaussian, z, uniform_times(8)).min() > 1


def test_ddim_with_rising_times_finds_the_noise_that_ddim_leads_back_from() -> None:
    x = MEAN + SPREAD * torch.randn(2, 3, 8, 8, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    noise, back = {}, {}
    for steps in (50, 100, 200):
        times = uniform_times(steps).double()
        z = ddim(gaussian, x, times.flip(0))
        noise[steps] = (z - (x - MEAN) / SPREAD).abs().max().item()
        back[steps] = (ddim(gaussian, z, times) - x).abs().max().item()
    # Both first order in the step.
    assert noise[200] < 0.1
    assert noise[200] < 0.6 * noise[100] < 0.36 * noise[50]
    assert back[200] < 0.1 * SPREAD
    assert back[200] < 0.6 * back[100] < 0.36 * back[50]


@pytest.mark.parametrize("spec", ["paper_like", "shipped_like"])
@pytest.mark.parametrize("sampler", ["ddim", "ddpm", "dpm-solver"])
def test_inpainting_keeps_known_pixels_and_bounds_the_rest(spec, sampler, request, picture, hole) -> None:
    prior = InpaintingPrior(request.getfixturevalue(spec))
    generator = torch.Generator().manual_seed(0)
    sample = inpaint(prior, picture, hole, steps=6, generator=generator, sampler=sampler)
    known = (1 - hole).expand_as(picture) > 0
    assert torch.equal(sample[known], picture[known])
    assert sample.abs().max() <= 1


def test_inpainting_never_sees_the_hole(shipped_like, picture, hole) -> None:
    prior = InpaintingPrior(shipped_like)
    marked = torch.where(hole > 0, torch.nan, picture)
    one, two = (inpaint(prior, x, hole, steps=4, generator=torch.Generator().manual_seed(0)) for x in (picture, marked))
    assert torch.equal(one, two)
