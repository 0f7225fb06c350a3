"""What the kernels take together: arrays that belong to one thing. Gradients come in the same groups."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]


class Network(NamedTuple):
    """Rows and the layers that they pass: ReLU between layers, the last linear. In gradients, None is not wanted."""

    x: Array | None
    """[n, i]; None in gradients alone."""
    weights: Sequence[Array]
    """[out, in] of each layer."""
    starts: Array | None
    """[m, out of the first layer]: what its sums start from, a row for each run of n / m <= 192 rows."""


class Samples(NamedTuple):
    """What rays meet between distances."""

    density: Array
    """[r, s], >= 0."""
    rgb: Array
    """[r, s, 3]."""
    tdist: Array
    """[r, s + 1], sorted."""


class SampleGradients(NamedTuple):
    """Of `Samples`; distances have none."""

    density: Array
    rgb: Array


class Rendered(NamedTuple):
    """What rays show."""

    weights: Array
    """[r, s]."""
    rgb: Array
    """[r, 3]."""
    opacity: Array
    """[r]."""
    depth_sum: Array
    """[r], weights x middle distance."""


class Logits(NamedTuple):
    """What colours are made of."""

    diffuse: Array
    """[n, 3]."""
    specular: Array | None
    """[n, 3]."""
    exposure: Array | None
    """[m, 6]: log gain and offset of the logits, a row for each run of n / m points."""


class ColourMap(NamedTuple):
    """From logits to colours: diffuse + scale * specular, then a sigmoid from -padding to 1 + padding."""

    scale: float
    padding: float


class Colours(NamedTuple):
    """[n, 3] each: of all logits, and of the diffuse ones alone. A gradient that is None is zero."""

    rgb: Array | None
    diffuse_rgb: Array | None


class Cells(NamedTuple):
    """Densities in the side^3 cells of a cube."""

    density: Array
    """[side^3]."""
    side: int
    bound: float | None
    """Half side of the cube, scene units; None: it holds space contracted into the ball of radius 2."""


class Rays(NamedTuple):
    """Rays that are cut at the same distances."""

    origins: Array
    """[r, 3]."""
    directions: Array
    """[r, 3]."""
    tdist: Array
    """[bins + 1], sorted."""


class Histogram(NamedTuple):
    """A histogram along each ray."""

    ends: Array
    """[r, n + 1], sorted."""
    weights: Array
    """[r, n]."""


class Splats(NamedTuple):
    """Gaussians in space."""

    mean: Array
    """[n, 3]."""
    log_scale: Array
    """[n, 3], of the standard deviation along each axis of its own."""
    rotation: Array
    """[n, 4], quaternion w x y z of any length."""
    opacity: Array
    """[n], logits."""
    rgb: Array
    """[n, 3]."""


class Pinhole(NamedTuple):
    """A camera; the picture's size is that of the array that it is written to."""

    intrinsics: tuple[float, float, float, float]
    """fx, fy, cx, cy, pixels; the first pixel's centre is at 0.5."""
    cam_from_world: Array
    """[3, 4]."""
    near: float
    """Depth > 0 of a centre up to which a splat is not seen."""
