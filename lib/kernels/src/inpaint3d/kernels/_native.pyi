from collections.abc import Sequence

from inpaint3d.kernels.arguments import (
    Array,
    Cells,
    ColourMap,
    Colours,
    Histogram,
    Logits,
    Network,
    Pinhole,
    Rays,
    Rendered,
    SampleGradients,
    Samples,
    Splats,
)

Level = tuple[int, int, int, bool]  # resolution, first entry, entries, dense
AdamStep = tuple[int, float, float, float, float, float, bool]  # step, lr, beta1, beta2, eps, decay, sparse

MOST_RUN: int
"""Rows that may share a start, at most."""

def isas() -> list[str]:
    """Paths that this processor runs, best first: of avx512, avx2, portable."""

def isa() -> str:
    """The path in use; the best one at first."""

def set_isa(name: str) -> None:
    """Force a path. ValueError where this processor or build has none of that name."""

def hash_forward(points: Array, table: Array, levels: Sequence[Level], out: Array, *, threads: int = 1) -> None:
    """Write the trilinear features of points [n, 3] in table [entries, c], 1 <= c <= 8, to out [n, levels * c]."""

def hash_backward(
    points: Array, out_grad: Array, levels: Sequence[Level], table_grad: Array, *, threads: int = 1
) -> None:
    """Write the gradient of hash_forward's table, given out_grad [n, levels * c], to table_grad [entries, c].

    Entries of no level keep what they hold.
    """

def mlp_forward(network: Network, out: Array, *, threads: int = 1) -> None:
    """Write the network's output to out [n, o]."""

def mlp_backward(network: Network, out_grad: Array, grads: Network, *, threads: int = 1) -> None:
    """Overwrite grads with mlp_forward's gradients, given out_grad [n, o]."""

def composite_forward(samples: Samples, out: Rendered, *, threads: int = 1) -> None:
    """Volume-render the samples of each ray; overwrites out."""

def composite_backward(
    samples: Samples, weights: Array, out_grads: Rendered, grads: SampleGradients, *, threads: int = 1
) -> None:
    """Overwrite grads, given composite_forward's weights and the gradients of its outputs."""

def colours_forward(logits: Logits, colour_map: ColourMap, out: Colours, *, threads: int = 1) -> None:
    """Write the colours of logits to out, whose arrays are both there."""

def colours_backward(
    logits: Logits, colour_map: ColourMap, out_grads: Colours, grads: Logits, *, threads: int = 1
) -> None:
    """Overwrite grads, the gradients of what colours_forward was given."""

def grid_histogram(cells: Cells, rays: Rays, floor: float, out: Array, *, threads: int = 1) -> None:
    """Write to out [r, bins] how rays may be sampled, from densities in cells.

    Weights of volume rendering, each averaged with its neighbours' where those are larger, plus floor.
    """

def grid_learn(density: Array, side: int, cube: Array, seen: Array, memory: float) -> None:
    """Lessen the cells [side^3] in which points of the cube [n, 3] lie to `memory` of themselves, once each; then raise
    them to the largest density seen [n], >= 0, of these points.
    """

def resample(sdist: Array, weights: Array, jitter: Array | None, out: Array, *, threads: int = 1) -> None:
    """Draw interval ends out [r, count + 1] from the histograms (sdist [r, n + 1] sorted, weights [r, n]).

    jitter [r, count] in [0, 1) places each draw in its stratum; None: in the middle.
    """

def unit_cube(points: Array, out: Array, *, threads: int = 1) -> None:
    """Write the points [n, 3], contracted into the ball of radius 2 and scaled to [0, 1]^3, to out [n, 3]."""

def interlevel_forward(histogram: Histogram, other: Histogram, out: Array, *, threads: int = 1) -> None:
    """Write to out [r] by how much the other histogram fails to bound the first: eq. 13 of arXiv:2111.12077, summed
    over the intervals of a ray.
    """

def interlevel_backward(
    histogram: Histogram, other: Histogram, out_grad: Array, grad: Array, *, threads: int = 1
) -> None:
    """Overwrite grad [r, m] with the gradient by the other's weights, given out_grad [r]."""

def adam(param: Array, grad: Array, m: Array, v: Array, how: AdamStep, *, threads: int = 1) -> int:
    """One step of Adam in place on flat param, m and v [n]; steps count from 1. Denormal moments become zero.

    decay: the gradient is grad + decay * param. sparse: numbers with grad = 0 are left alone, moments too. So are those
    whose grad is not finite: how many is returned.
    """

def splats_forward(splats: Splats, camera: Pinhole, rgb: Array, *, threads: int = 1) -> None:
    """Write what a camera sees of splats, before black, to rgb [h, w, 3]."""

def splats_backward(
    splats: Splats, camera: Pinhole, rgb: Array, rgb_grad: Array, grads: Splats, *, threads: int = 1
) -> None:
    """Overwrite grads, given splats_forward's rgb and its gradient, [h, w, 3] both."""
