"""Depth maps that keep to the planes of the scene.

What a mask hides, a field has seen from few sides: its depth there is soft, and colours that are taken from other
photos by it come from beside the place that is meant. Most of what people build is flat, and triangulated points say
where, to a fraction of a pixel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.planes import PLANE_PIXELS, Plane, fit_planes
from inpaint3d.scene.visibility import CoarseView

MAX_CHANGE = 0.15
"""Share by which a depth may change: where a ray grazes a plane it meets it anywhere."""


@dataclass(frozen=True)
class FlatScene:
    """The planes of a scene, and how far a point of theirs may lie off them, scene units."""

    planes: Sequence[Plane]
    tolerance: float

    @classmethod
    def find(
        cls, views: Sequence[MaskedView], depths: Mapping[str, NDArray[np.float32]], points: NDArray[np.float32]
    ) -> "FlatScene":
        """In the sparse points [n, 3] of the views."""
        pixel = np.median([np.median(depths[v.name]) / v.camera.fx for v in views])
        return cls(fit_planes(points, PLANE_PIXELS * float(pixel)), PLANE_PIXELS * float(pixel))

    def snap(self, coarse: CoarseView, times: NDArray[np.floating] | float) -> CoarseView:
        """A view with what lies within so many `times` the tolerance of a plane on it."""
        return replace(coarse, depth=snap_to_planes(coarse.depth, coarse.camera, self.planes, times * self.tolerance))


def snap_to_planes(
    depth: NDArray[np.floating], camera: Camera, planes: Sequence[Plane], reach: NDArray[np.floating] | float
) -> NDArray[np.float32]:
    """A depth map z [h, w] with what lies within `reach` (scene units, of all or of each cell) of a plane on it.

    Cells are moved along their rays, to the nearest plane.
    """
    pixels = camera.pixel_centres().reshape(-1, 2)
    given = depth.reshape(-1).astype(np.float64)
    points = camera.unproject(pixels, given)
    nearest, moved = np.broadcast_to(reach, depth.shape).reshape(-1), given
    for plane in planes:
        apart, there = plane.distance(points), plane.depth(camera, pixels)
        better = (apart < nearest) & (np.abs(there - given) < MAX_CHANGE * given)
        nearest, moved = np.where(better, apart, nearest), np.where(better, there, moved)
    return moved.reshape(depth.shape).astype(np.float32)
