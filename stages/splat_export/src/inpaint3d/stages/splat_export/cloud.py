"""Gaussian splats as arrays: what is fitted, and what the writers of formats take."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float32]

SH_DEGREE_0 = 0.28209479177387814
"""The spherical harmonic of degree 0, 1 / (2 sqrt(pi)): a coefficient c is the colour 0.5 + SH_DEGREE_0 c."""
HALF = np.sqrt(0.5)
Z_UP, Y_DOWN, Y_UP = (1.0, 0.0, 0.0, 0.0), (HALF, HALF, 0.0, 0.0), (HALF, -HALF, 0.0, 0.0)
"""Quaternions w, x, y, z from the scene's axes to those of a format: as they are; (x, -z, y); (x, z, -y)."""


@dataclass(frozen=True, eq=False)
class SplatCloud:
    """n Gaussians, float32; z is up."""

    mean: Floats
    """[n, 3], scene units."""
    log_scale: Floats
    """[n, 3], of the standard deviation along each of its own axes, scene units."""
    rotation: Floats
    """[n, 4], world from its own axes: quaternions w, x, y, z of any length."""
    opacity: Floats
    """[n], logits."""
    rgb: Floats
    """[n, 3], sRGB-encoded, in [0, 1], the same from everywhere."""

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def arrays(self) -> dict[str, Floats]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def map(self, change: Any) -> "SplatCloud":
        """The same with `change` applied to every array."""
        return replace(self, **{name: change(array) for name, array in self.arrays.items()})

    @property
    def alpha(self) -> Floats:
        """Opacities [n] in [0, 1]."""
        return (1 / (1 + np.exp(-self.opacity.astype(np.float64)))).astype(np.float32)

    @property
    def coefficients(self) -> Floats:
        """Of degree 0, [n, 3]."""
        return ((self.rgb - 0.5) / np.float32(SH_DEGREE_0)).astype(np.float32)

    @property
    def quaternion(self) -> Floats:
        """Rotations [n, 4] of unit length, w at least 0."""
        unit = self.rotation / np.linalg.norm(self.rotation, axis=1, keepdims=True)
        return np.where(unit[:, :1] < 0, -unit, unit).astype(np.float32)

    def turn(self, quaternion: ArrayLike) -> "SplatCloud":
        """The same in the axes that a unit quaternion w, x, y, z leads to."""
        turn = np.asarray(quaternion, np.float64)
        w, axis = turn[0], turn[1:]
        mean = self.mean.astype(np.float64)
        across = np.cross(axis, mean)
        mean = mean + 2 * (w * across + np.cross(axis, across))
        own_w, own = self.quaternion[:, :1].astype(np.float64), self.quaternion[:, 1:].astype(np.float64)
        together = [w * own_w - (own @ axis)[:, None], w * own + own_w * axis + np.cross(axis, own)]
        rotation = np.concatenate(together, 1).astype(np.float32)
        return replace(self, mean=mean.astype(np.float32), rotation=rotation)
