"""Masks of volumes: a pixel is in the hole where its ray meets the volume (the paper's ray-mask intersection)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.contracts.models.base import Vector3
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.geometry import ray_box, ray_sphere

Bools = NDArray[np.bool_]


def sphere(centre: ArrayLike, radius: float, *, inverted: bool = False) -> Primitive:
    """A sphere in scene units; `inverted`: the hole is all that lies outside it."""
    return Primitive(kind="sphere", centre=_to_xyz(centre), size=_to_xyz([2 * radius] * 3), inverted=inverted)


def box(centre: ArrayLike, size: ArrayLike, yaw_deg: float = 0.0, *, inverted: bool = False) -> Primitive:
    """A box of full sides `size` in scene units, turned counter-clockwise about z."""
    return Primitive(kind="box", centre=_to_xyz(centre), size=_to_xyz(size), yaw_deg=float(yaw_deg), inverted=inverted)


def volume_mask(camera: Camera, primitive: Primitive) -> Bools:
    """Pixels [h, w] whose ray (through the pixel's centre) is in the hole.

    A plain volume: the ray meets it in front of the camera. An inverted one: the ray misses it (the conformance list's
    M4), so that what is seen through the volume stays as the only context.
    """
    origins, directions = camera.rays()
    if primitive.kind == "sphere":
        *_, hit = ray_sphere(origins, directions, primitive.centre, primitive.size[0] / 2)
    else:
        *_, hit = ray_box(origins, directions, primitive.centre, primitive.size, primitive.yaw_deg)
    return ~hit if primitive.inverted else hit


def _to_xyz(values: ArrayLike) -> Vector3:
    x, y, z = (float(v) for v in np.asarray(values, np.float64))
    return (x, y, z)
