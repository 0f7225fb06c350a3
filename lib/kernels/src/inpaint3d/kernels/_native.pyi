from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Level = tuple[int, int, int, bool]  # resolution, first entry, entries, dense

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

def mlp_forward(x: Array, weights: Sequence[Array], starts: Array | None, out: Array, *, threads: int = 1) -> None:
    """Write the network's output for x [n, i] to out [n, o]: weights [out, in], ReLU between layers, the last linear.

    starts [m, out of the first layer]: what its sums start from, a row for each run of n / m <= 192 rows.
    """

def mlp_backward(
    x: Array,
    weights: Sequence[Array],
    starts: Array | None,
    out_grad: Array,
    x_grad: Array | None,
    weight_grads: Sequence[Array],
    starts_grad: Array | None,
    *,
    threads: int = 1,
) -> None:
    """Overwrite x_grad, weight_grads and starts_grad with mlp_forward's gradients, given out_grad [n, o]."""

def composite_forward(
    density: Array,
    rgb: Array,
    tdist: Array,
    weights: Array,
    rgb_out: Array,
    opacity: Array,
    depth_sum: Array,
    *,
    threads: int = 1,
) -> None:
    """Volume-render density [r, s] (>= 0) and rgb [r, s, 3] between the distances tdist [r, s + 1], sorted.

    Writes weights [r, s], rgb_out [r, 3], opacity [r] and the sum of weights x middle distance [r].
    """

def composite_backward(
    density: Array,
    rgb: Array,
    tdist: Array,
    weights: Array,
    weights_grad: Array,
    rgb_out_grad: Array,
    opacity_grad: Array,
    depth_sum_grad: Array,
    density_grad: Array,
    rgb_grad: Array,
    *,
    threads: int = 1,
) -> None:
    """Overwrite density_grad and rgb_grad, given composite_forward's weights and the gradients of its outputs."""

def colours_forward(
    diffuse: Array,
    specular: Array | None,
    exposure: Array | None,
    rgb: Array,
    diffuse_rgb: Array,
    *,
    scale: float,
    padding: float,
    threads: int = 1,
) -> None:
    """Write the colours of logits diffuse + scale * specular [n, 3] to rgb, of diffuse alone to diffuse_rgb [n, 3].

    exposure [m, 6]: log gain and offset of the logits, a row for each run of n / m points. Then a sigmoid from
    -padding to 1 + padding.
    """

def colours_backward(
    diffuse: Array,
    specular: Array | None,
    exposure: Array | None,
    rgb_grad: Array | None,
    diffuse_rgb_grad: Array | None,
    diffuse_grad: Array,
    specular_grad: Array | None,
    exposure_grad: Array | None,
    *,
    scale: float,
    padding: float,
    threads: int = 1,
) -> None:
    """Overwrite the gradients of what colours_forward was given; that of an output is zero where it is None."""

def grid_histogram(
    density: Array,
    side: int,
    origins: Array,
    directions: Array,
    tdist: Array,
    bound: float | None,
    floor: float,
    out: Array,
    *,
    threads: int = 1,
) -> None:
    """Write to out [r, bins] how rays [r, 3] may be sampled between tdist [bins + 1], from densities in side^3 cells.

    Weights of volume rendering, each averaged with its neighbours' where those are larger, plus floor. bound: half side
    of the cells' cube; None: it holds space contracted into the ball of radius 2.
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

def interlevel_forward(
    ends: Array, weights: Array, other_ends: Array, other_weights: Array, out: Array, *, threads: int = 1
) -> None:
    """Write to out [r] by how much the histogram (other_ends [r, m + 1], other_weights [r, m]) fails to bound
    (ends [r, n + 1], weights [r, n]): eq. 13 of arXiv:2111.12077, summed over the intervals of a ray.
    """

def interlevel_backward(
    ends: Array,
    weights: Array,
    other_ends: Array,
    other_weights: Array,
    out_grad: Array,
    grad: Array,
    *,
    threads: int = 1,
) -> None:
    """Overwrite grad [r, m] with the gradient by other_weights, given out_grad [r]."""

def adam(
    param: Array,
    grad: Array,
    m: Array,
    v: Array,
    *,
    step: int,
    lr: float,
    beta1: float,
    beta2: float,
    eps: float,
    decay: float = 0.0,
    sparse: bool = False,
    threads: int = 1,
) -> int:
    """One step of Adam in place on flat param, m and v [n]; `step` counts from 1. Denormal moments become zero.

    decay: the gradient is grad + decay * param. sparse: numbers with grad = 0 are left alone, moments too. So are those
    whose grad is not finite: how many is returned.
    """
