"""Training a prior: the loss, one step, the running average of weights, and a checkpoint that resumes exactly.

Randomness is counted, not carried: everything a step draws comes from (seed, step), so that a run that was killed and
resumed draws what the unbroken one would have.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from safetensors.torch import load_file, save_file
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.kit.checkpoints import OPEN_SEAL, find_checkpoint, write_checkpoint
from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion.bands import pixel_variance
from inpaint3d.diffusion.denoiser import Image, Mask
from inpaint3d.diffusion.parallel import average_over_ranks
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.schedules import cosine_time_of
from inpaint3d.scene.finite import find_non_finite


@dataclass(frozen=True)
class Batch:
    """Pictures to learn from. `hole` is what the network must fill, `teach` where the truth is known to the loss."""

    image: Image
    """In [-1, 1]; anything finite where `teach` is 0."""
    hole: Mask
    teach: Mask
    """1 where the loss may look; a pixel with 0 must lie in the hole, so that it is never shown either."""

    def to(self, device: torch.device | str) -> "Batch":
        """The same on a device, in float32; from pinned memory without waiting."""
        moved = (part.to(device, non_blocking=True).float() for part in (self.image, self.hole, self.teach))
        return Batch(*moved)

    def pin_memory(self) -> "Batch":
        """The same in memory that a GPU reads by itself; what torch's data loader calls."""
        return Batch(self.image.pin_memory(), self.hole.pin_memory(), self.teach.pin_memory())


@dataclass
class TrainingState:
    """What a checkpoint holds."""

    prior: InpaintingPrior
    average: InpaintingPrior
    """Exponential moving average of the weights: the one that is used afterwards."""
    optimiser: torch.optim.Adam
    step: int = 0
    curve: list[tuple[int, float, float]] = field(default_factory=list)
    """(step, loss averaged since the row before, loss on held-out pictures)."""
    pending: list[float] = field(default_factory=list)
    """Losses since the last row of the curve."""

    def close_row(self, held_out_loss: float) -> None:
        """Turn the pending losses into a row of the curve. Steps without a finite loss are left out of the average."""
        finite = [loss for loss in self.pending if math.isfinite(loss)]
        self.curve.append((self.step, float(np.mean(finite)) if finite else math.inf, held_out_loss))
        self.pending.clear()


def begin(
    spec: PriorSpec,
    seed: int,
    start: InpaintingPrior | None = None,
    *,
    bf16: bool = False,
    channels_last: bool = False,
    device: torch.device | str = "cpu",
) -> TrainingState:
    """A fresh state: random weights of this seed, or those of `start`, with a new optimiser.

    channels_last: keep weights and features with the channels innermost, which some processors convolve faster.
    """
    prior, average = InpaintingPrior(spec, seed, bf16=bf16), InpaintingPrior(spec, seed, bf16=bf16)
    if start is not None:
        prior.load_state_dict(start.state_dict())
        average.load_state_dict(start.state_dict())
    average.requires_grad_(False).eval()
    prior, average = prior.to(device), average.to(device)
    if channels_last:
        prior, average = (p.to(memory_format=torch.channels_last) for p in (prior, average))
    optimiser = torch.optim.Adam(prior.parameters(), lr=1e-4, betas=(0.9, 0.99), fused=True)
    return TrainingState(prior, average, optimiser)


def step_generators(
    seed: int, step: int, part: int = 0, device: torch.device | str = "cpu"
) -> tuple[np.random.Generator, torch.Generator]:
    """The randomness of one part of a step's batch: the same whether or not the run was interrupted before it.

    The second generator draws on `device`, whose numbers are its own: a GPU's are not a processor's.
    """
    entropy = np.random.SeedSequence((seed, step, part))
    seed_for_torch = int(entropy.generate_state(1, np.uint64)[0] >> 1)
    return np.random.default_rng(entropy), torch.Generator(device).manual_seed(seed_for_torch)


def denoising_loss(
    prior: InpaintingPrior,
    batch: Batch,
    generator: torch.Generator,
    t_range: tuple[float, float] = (0.0, 1.0),
) -> Float[Tensor, ""]:
    """Mean squared error of the network's output over the pixels that the spec's loss looks at (D8, D9, D11).

    The mean is per picture, then over pictures, so that a small hole weighs as much as a large one.
    """
    spec, count, drawn_on = prior.spec, len(batch.image), generator.device
    # Stratified: a batch covers all noise levels, which takes noise out of the loss (VDM, arXiv:2107.00630, I.1).
    within = torch.rand(count, generator=generator, device=drawn_on)
    stratum = (torch.arange(count, device=drawn_on) + within) / count
    order = torch.randperm(count, generator=generator, device=drawn_on)
    t = t_range[0] + (t_range[1] - t_range[0]) * stratum[order]
    t = cosine_time_of(t, spec.schedule, spec.size)
    eps = torch.randn(batch.image.shape, generator=generator, device=drawn_on)
    noise_fill = torch.randn(batch.image.shape, generator=generator, device=drawn_on)
    dropped = (torch.rand(count, 1, 1, 1, generator=generator, device=drawn_on) < spec.condition_dropout).float()
    device = batch.image.device
    t, eps, noise_fill, dropped = (tensor.to(device) for tensor in (t, eps, noise_fill, dropped))

    hole = torch.maximum(batch.hole, dropped.expand_as(batch.hole))
    fill = prior.fill_hole(batch.image, hole, noise_fill)
    # Where the truth is unknown z is made of the fill: never of a pixel that must not be learnt.
    x = torch.where(batch.teach > 0, batch.image, stand_in_for(fill, hole, spec))
    region = batch.teach * (hole if spec.loss_region == "hole" else 1)
    squared = (_compute_error(prior, x, eps, t, fill, hole).square() * region).sum(dim=(1, 2, 3))
    return (squared / (3 * region.sum(dim=(1, 2, 3))).clamp(min=1)).mean()


def _compute_error(prior: InpaintingPrior, x: Image, eps: Image, t: Tensor, fill: Image, hole: Mask) -> Image:
    """What is squared: the error of the network's output, or for `residual` that of the clean picture."""
    parameterisation = prior.parameterisation(t)
    a, s = parameterisation.levels
    z = prior.prepare_z(a * x + s * eps, t, fill, hole)
    output = prior(z, t, fill, hole)
    if prior.spec.prediction != "residual":
        return output - parameterisation.target(x, eps, fill)
    # Weighted by the error of a guess with one variance for all bands (EDM's weight). Weighted band by band, the
    # finest, three quarters of all numbers, would drown the coarse ones that matter to the eye.
    variance = pixel_variance(prior.spec.residual_bands) * float(np.square(prior.spec.residual_colours).mean())
    unit = s * (variance / (a**2 * variance + s**2)).sqrt()
    return (parameterisation.clean(output, z, fill) - x) / unit


def stand_in_for(fill: Image, hole: Mask, spec: PriorSpec) -> Image:
    """A stand-in for pixels nobody may see: the smooth fill, or mid grey where the condition holds noise."""
    return fill if spec.condition == "mask-channel" else torch.where(hole > 0, 0.0, fill)


def train_step(
    state: TrainingState,
    *losses: Callable[[InpaintingPrior], Tensor],
    learning_rate: float,
    ema: float = 0.9999,
    clip: float = 1.0,
) -> float:
    """One Adam step with clipped gradients and the running average (D13). Returns the loss.

    losses: one for each part of the batch. Gradients of their mean are accumulated part by part, so that memory is that
    of one, and averaged over the ranks, each of which brings as many parts of its own.

    A step whose gradient is not finite changes nothing but the step count, and returns the non-finite loss: the caller
    counts and reports it.
    """
    for group in state.optimiser.param_groups:
        group["lr"] = learning_rate
    state.optimiser.zero_grad(set_to_none=True)
    loss = torch.zeros((), device=next(state.prior.parameters()).device)
    for loss_of in losses:
        part = loss_of(state.prior) / len(losses)
        part.backward()
        loss += part.detach()
    average_over_ranks([loss, *(p.grad for p in state.prior.parameters() if p.grad is not None)])
    norm = torch.nn.utils.get_total_norm([p.grad for p in state.prior.parameters() if p.grad is not None])
    state.step += 1
    if not torch.isfinite(norm):
        state.pending.append(math.nan)
        return math.nan
    torch.nn.utils.clip_grads_with_norm_(state.prior.parameters(), clip, norm)
    state.optimiser.step()
    # Warm-up: early on the average must forget the random start faster than the final decay would.
    decay = min(ema, (1 + state.step) / (10 + state.step))
    # All weights at once: on a GPU a few launches, not one for each.
    get_ema_multi_avg_fn(decay)(list(state.average.parameters()), list(state.prior.parameters()), None)
    state.pending.append(loss.item())
    return state.pending[-1]


def rate_after_warm_up(peak: float, step: int, total: int, warm_up: int, final_share: float = 0.1) -> float:
    """Learning rate: linear warm-up, then a cosine from `peak` to `final_share * peak` at `total`."""
    if step < warm_up:
        return peak * (step + 1) / warm_up
    progress = min(1.0, (step - warm_up) / max(1, total - warm_up))
    return peak * (final_share + (1 - final_share) * 0.5 * (1 + float(np.cos(np.pi * progress))))


def save_checkpoint(path: Path, state: TrainingState) -> None:
    """Everything needed to go on exactly, in one file that appears whole or not at all.

    NonFiniteError where a weight, an average or a moment is not finite: the checkpoint that is there stays.
    """
    tensors = {f"prior.{name}": value for name, value in state.prior.state_dict().items()}
    tensors |= {f"average.{name}": value for name, value in state.average.state_dict().items()}
    for name, parameter in state.prior.named_parameters():
        for key, value in state.optimiser.state.get(parameter, {}).items():
            tensors[f"optimiser.{key}.{name}"] = value
    check_finite_weights(tensors, state.step)
    tensors["step"] = torch.tensor(state.step)
    tensors["curve"] = torch.tensor(state.curve, dtype=torch.float64).reshape(-1, 3)
    tensors["pending"] = torch.tensor(state.pending, dtype=torch.float64)
    written = {name: value.detach().contiguous() for name, value in tensors.items()}
    write_checkpoint(path, lambda staged: save_file(written, staged, metadata=OPEN_SEAL))


def check_finite_weights(tensors: Mapping[str, Tensor], step: int | None = None) -> None:
    """NonFiniteError where one of a prior's tensors is not finite."""
    found = find_non_finite({name: t.detach().float().cpu().numpy() for name, t in tensors.items()})
    if found:
        after = "" if step is None else f" after step {step}"
        raise NonFiniteError(f"the prior is not finite{after}: {', '.join(map(str, found[:5]))}")


def load_checkpoint(path: Path, state: TrainingState) -> bool:
    """Put `state` back to where the newest whole checkpoint was taken; False where there is none.

    Its spec must be the same (ValueError otherwise).
    """
    found = find_checkpoint(path)
    if found is None:
        return False
    tensors = load_file(found)
    try:
        state.prior.load_state_dict(_take_prefix(tensors, "prior."))
        state.average.load_state_dict(_take_prefix(tensors, "average."))
    except RuntimeError as error:
        raise ValueError(f"checkpoint {path} belongs to another architecture: {error}") from error
    state.optimiser.state.clear()
    for name, parameter in state.prior.named_parameters():
        if f"optimiser.step.{name}" in tensors:
            moments = {key: tensors[f"optimiser.{key}.{name}"] for key in ("step", "exp_avg", "exp_avg_sq")}
            # On the parameter's own device, in its own memory format, which the fused step takes for granted.
            state.optimiser.state[parameter] = {
                key: value.to(parameter.device) if value.ndim == 0 else torch.empty_like(parameter).copy_(value)
                for key, value in moments.items()
            }
    state.step = int(tensors["step"])
    state.curve = [(int(step), loss, held_out) for step, loss, held_out in tensors["curve"].tolist()]
    state.pending = tensors["pending"].tolist()
    return True


def _take_prefix(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
