"""Unbounded space in a ball of radius 2 and back (Mip-NeRF 360, arXiv:2111.12077, eq. 10), without a tensor library."""

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]

FARTHEST = 1.995  # contracted radius of the farthest surface: 200 scene units


def contract(points: Points) -> Points:
    """Scene points [*n, 3] into the ball: the identity inside the unit ball, (2 - 1/|x|) x/|x| outside."""
    length = np.maximum(_measure_length(points), 1.0)
    return points * ((2 - 1 / length) / length)


def expand(points: Points) -> Points:
    """Scene points [*n, 3] of contracted ones; what lies beyond `FARTHEST` is brought there."""
    length = _measure_length(points)
    bounded = np.clip(length, 1.0, FARTHEST)
    return points * np.where(length > 1.0, 1 / ((2 - bounded) * np.maximum(length, 1.0)), 1.0)


def measure_stretch(points: Points) -> Points:
    """How long a short radial step of contracted space is in the scene, at scene points [*n, 3]: max(1, |x|)^2."""
    return np.maximum(np.einsum("...c,...c->...", points, points), 1.0)


def _measure_length(points: Points) -> Points:
    """Lengths [*n, 1]; sums over three numbers are slow in numpy, but not this way."""
    return np.sqrt(np.einsum("...c,...c->...", points, points))[..., None]
