"""The readable truth of every heavy operation; `native` must match it forward and backward."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int64
from torch import Tensor

from inpaint3d.radiance import safe
from inpaint3d.radiance.architecture import Level, levels_of
from inpaint3d.radiance.contraction import unit_cube
from inpaint3d.radiance.volume import alpha_weights

__all__ = [
    "AdamStep", "Cells", "Level", "adam_step", "colours", "composite", "grid_histogram", "grid_learn", "hash_encode",
    "interlevel", "levels_of", "mlp", "resample", "unit_cube",
]  # fmt: skip

# The map of colours reaches a little past [0, 1], so that black and white are not at infinity (Mip-NeRF).
COLOUR_PADDING = 0.001
# Instant-NGP's spatial hash (arXiv:2201.05989, eq. 4).
PRIMES = (1, 2654435761, 805459861)


def corners(points: Float[Tensor, "3 n"], level: Level) -> tuple[Int64[Tensor, "8 n"], Float[Tensor, "8 n"]]:
    """Entries, counted from the level's own first, of the eight corners around each point; their trilinear weights.

    Corners count x fastest. Points come last so that every operation runs along memory.
    """
    scaled = points * level.resolution
    low = scaled.detach().floor().clamp_(0, level.resolution - 1)
    share = torch.stack([low + 1 - scaled, scaled - low])  # [2, 3, n]
    # A point that is NaN is read at the origin, as a NaN is no number of a cell; its weights still tell what it was.
    vertex = torch.stack([low, low + 1]).masked_fill(low.isnan(), 0).long()
    weights = share[:, None, None, 2] * share[None, :, None, 1] * share[None, None, :, 0]
    x, y, z = vertex[None, None, :, 0], vertex[None, :, None, 1], vertex[:, None, None, 2]
    if level.dense:
        side = level.resolution + 1
        entry = x + (side * y + (side * side) * z)
    else:
        # Instant-NGP multiplies in 32 bits. int64 products never wrap here, and the mask keeps only low bits.
        last = level.size - 1
        entry = (x * PRIMES[0] & last) ^ ((y * PRIMES[1] & last) ^ (z * PRIMES[2] & last))
    return entry.reshape(8, -1), weights.reshape(8, -1)


def hash_encode(
    points: Float[Tensor, "n 3"], table: Float[Tensor, "entries c"], levels: Sequence[Level]
) -> Float[Tensor, "n {len(levels)}*c"]:
    """Features of a multiresolution hash grid, trilinear (Instant-NGP, arXiv:2201.05989).

    points lie in [0, 1] (outside, the border cell extrapolates). Level 0's c channels come first. Differentiable in
    the table and, where they ask for it, in the points.
    """
    along = points.T.contiguous()
    features: list[Tensor] = []
    for part, level in zip(table.split([level.size for level in levels]), levels, strict=True):
        entry, weights = corners(along, level)
        # One plane per channel: gathering, and adding gradients back, is several times faster than in rows of c.
        gathered = part.T.contiguous().index_select(1, entry.reshape(-1)).reshape(-1, 8, len(points))
        features.append((gathered * weights).sum(1))
    return torch.cat(features).T


def mlp(
    x: Float[Tensor, "n i"],
    weights: Sequence[Float[Tensor, "_ _"]],
    starts: Float[Tensor, "m {weights[0].shape[0]}"] | None = None,
) -> Float[Tensor, "n {weights[-1].shape[0]}"]:
    """A fully connected network without biases: weights [out, in]; ReLU between layers, the last one linear.

    starts: what the first layer's sums start from, a row for each run of n / m rows: inputs that a run shares, times
    their part of the first weights.
    """
    for layer, weight in enumerate(weights):
        x = F.linear(F.relu(x) if layer else x, weight)
        if layer == 0 and starts is not None:
            x = x + starts.repeat_interleave(len(x) // max(len(starts), 1), 0)
    return x


def colours(
    diffuse: Float[Tensor, "n 3"],
    specular: Float[Tensor, "n 3"] | None,
    exposure: Float[Tensor, "m 6"] | None,
    specular_scale: float = 1.0,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """Colours in [-0.001, 1.001] of the logits diffuse + specular_scale * specular, and of diffuse alone (N4).

    A sigmoid-like map of the paper's sum, once it is exposed (N6): log gain and offset of the logits, a row for each
    run of n / m points.
    """

    def to_colour(logits: Tensor) -> Tensor:
        if exposure is not None:
            runs = logits.reshape(len(exposure), len(logits) // max(len(exposure), 1), 3)
            logits = torch.addcmul(exposure[:, None, 3:], runs, torch.exp(exposure[:, None, :3])).flatten(0, 1)
        return safe.sigmoid(logits) * (1 + 2 * COLOUR_PADDING) - COLOUR_PADDING

    both = diffuse if specular is None else torch.add(diffuse, specular, alpha=specular_scale)
    return to_colour(both), to_colour(diffuse)


class Cells(NamedTuple):
    """Densities in the side^3 cells of the cube that hash grids live in (`unit_cube`)."""

    density: Float[Tensor, " cells"]
    side: int
    contraction: bool
    bound: float


@torch.no_grad()
def grid_histogram(
    cells: Cells,
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    tdist: Float[Tensor, " ends"],
    floor: float,
) -> Float[Tensor, "r ends-1"]:
    """How rays are to be sampled between tdist, by the densities in cells.

    The weights are those of volume rendering, of what is looked up at the intervals' middles, spread to neighbours and
    raised by a floor as in Mip-NeRF (arXiv:2103.13415, section 3.1), since a surface may lie beside the middle.
    """
    middle = (tdist[1:] + tdist[:-1]) / 2
    points = torch.addcmul(origins[:, None], directions[:, None], middle[:, None]).reshape(-1, 3)
    cell = _find_cell(unit_cube(points, cells.contraction, cells.bound), cells.side)
    weights = alpha_weights(cells.density[cell].reshape(len(origins), len(middle)), tdist.expand(len(origins), -1))
    larger = F.max_pool1d(weights[:, None], 2, stride=1, padding=1)[:, 0]
    return (larger[:, 1:] + larger[:, :-1]) / 2 + floor


@torch.no_grad()
def grid_learn(
    density: Float[Tensor, " cells"],
    side: int,
    cube: Float[Tensor, "n 3"],
    seen: Float[Tensor, " n"],
    memory: float,
) -> None:
    """Lessen, in place, the cells in which points of the cube lie to `memory` of themselves, and raise them to the
    largest density that was seen there.
    """
    cell = _find_cell(cube, side)
    density[cell] = memory * density[cell]  # equal cells are given equal numbers: no order matters
    density.scatter_reduce_(0, cell, seen, "amax")


def _find_cell(cube: Float[Tensor, "n 3"], side: int) -> Int64[Tensor, " n"]:
    x, y, z = (cube * side).long().clamp_(0, side - 1).unbind(1)
    return (z * side + y) * side + x


def composite(
    density: Float[Tensor, "r s"], rgb: Float[Tensor, "r s 3"], tdist: Float[Tensor, "r s+1"]
) -> tuple[Float[Tensor, "r s"], Float[Tensor, "r 3"], Float[Tensor, " r"], Float[Tensor, " r"]]:
    """Volume rendering over no background: weights, colour, opacity, and the sum of weights x middle distance.

    density per scene unit, tdist interval ends along unit-length rays; the last is not divided by opacity.
    """
    weights = alpha_weights(density, tdist)
    middle = (tdist[:, 1:] + tdist[:, :-1]) / 2
    return weights, (weights[..., None] * rgb).sum(1), weights.sum(1), (weights * middle).sum(1)


@torch.no_grad()
def resample(
    sdist: Float[Tensor, "r ends"],
    weights: Float[Tensor, "r ends-1"],
    count: int,
    jitter: Float[Tensor, "r {count}"] | None = None,
) -> Float[Tensor, "r {count}+1"]:
    """Draw `count` >= 2 new intervals where the histogram has weight (Mip-NeRF 360, arXiv:2111.12077, appendix).

    One centre per stratum of the inverse CDF, at `jitter` (in [0, 1)) of the stratum, in its middle where that is None;
    the ends lie halfway between centres. Sorted, within [sdist[0], sdist[-1]]. No gradient.
    """
    if count < 2:
        raise ValueError(f"resample draws at least 2 intervals, not {count}")
    # Keeps empty rays well defined: they are sampled evenly in s. Zero-width intervals still get nothing.
    mass = weights + torch.finfo(weights.dtype).eps * torch.diff(sdist)
    cdf = F.pad(torch.cumsum(mass, -1), (1, 0))
    cdf = cdf / cdf[:, -1:]
    stratum = torch.arange(count, dtype=sdist.dtype, device=sdist.device)
    u = ((stratum + (0.5 if jitter is None else jitter)) / count).expand(len(sdist), count).contiguous()
    right = torch.searchsorted(cdf, u, right=True).clamp_(1, weights.shape[1])
    cdf_low, cdf_high = cdf.gather(1, right - 1), cdf.gather(1, right)
    s_low, s_high = sdist.gather(1, right - 1), sdist.gather(1, right)
    gap = cdf_high - cdf_low
    share = ((u - cdf_low) / torch.where(gap <= 0, 1, gap)).clamp_(0, 1)
    centres = s_low + share * (s_high - s_low)
    middles = (centres[:, 1:] + centres[:, :-1]) / 2
    first = torch.maximum(2 * centres[:, :1] - middles[:, :1], sdist[:, :1])
    last = torch.minimum(2 * centres[:, -1:] - middles[:, -1:], sdist[:, -1:])
    return torch.cat([first, middles, last], 1)


def interlevel(
    ends: Float[Tensor, "r n"],
    weights: Float[Tensor, "r n-1"],
    other_ends: Float[Tensor, "r m"],
    other_weights: Float[Tensor, "r m-1"],
) -> Float[Tensor, " r"]:
    """How far the other histogram fails to bound the first, for each ray (Mip-NeRF 360, arXiv:2111.12077, eq. 13).

    ends are sorted, weights >= 0. Differentiable in other_weights; the first histogram is taken as it is.
    """
    weights = weights.detach()
    lacking = (weights - outer_measure(ends.detach(), other_ends.detach(), other_weights)).clamp(min=0)
    return (lacking.square() / (weights + torch.finfo(weights.dtype).eps)).sum(-1)


def outer_measure(
    ends: Float[Tensor, "r n"], other_ends: Float[Tensor, "r m"], other_weights: Float[Tensor, "r m-1"]
) -> Float[Tensor, "r n-1"]:
    """For each interval, the sum of the other histogram's weights that overlap it, in whole (ibid., eq. 12)."""
    reached = F.pad(torch.cumsum(other_weights, -1), (1, 0))
    other_ends = other_ends.contiguous()
    last = other_weights.shape[1]
    low = torch.searchsorted(other_ends, ends[:, :-1].contiguous(), right=True).sub_(1).clamp_(0, last)
    high = torch.searchsorted(other_ends, ends[:, 1:].contiguous()).clamp_(0, last)
    return (reached.gather(1, high) - reached.gather(1, low)).clamp(min=0)


class AdamStep(NamedTuple):
    """How Adam moves a parameter at one step; `step` counts from 1.

    decay: what is descended has decay / 2 * |param|^2 added to it. sparse: numbers whose gradient is 0 are left alone.
    """

    step: int
    lr: float
    beta1: float
    beta2: float
    eps: float
    decay: float = 0.0
    sparse: bool = False


@torch.no_grad()
def adam_step(
    param: Float[Tensor, "*shape"],
    grad: Float[Tensor, "*shape"],
    m: Float[Tensor, "*shape"],
    v: Float[Tensor, "*shape"],
    how: AdamStep,
) -> int | Tensor:
    """One step of Adam (arXiv:1412.6980, algorithm 1) in place on param, m and v.

    Numbers that the step would not leave finite are left alone, moments too: how many is returned, as a tensor, since
    whoever reads it waits for the device. That is where the gradient is not finite, where its square overflows (a
    second moment that is infinite stops a number for good), and where the number or its moments are not finite already.
    """
    step, lr, beta1, beta2, eps, decay, sparse = how
    wanted = grad != 0 if sparse else torch.ones_like(grad, dtype=torch.bool)
    slope = grad + decay * param
    first = torch.lerp(m, slope, 1 - beta1)
    second = beta2 * v + (1 - beta2) * slope.square()
    step_size = lr / (1 - beta1**step)
    to = param - step_size * first / ((second / (1 - beta2**step)).sqrt_() + eps)
    finite = torch.isfinite(second) & torch.isfinite(to)
    for part, moved in ((param, to), (m, first), (v, second)):
        part.copy_(torch.where(wanted & finite, moved, part))
    return (wanted & ~finite).sum()
