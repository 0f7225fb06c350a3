"""Depth maps that keep to the planes of the scene.

What a mask hides, a field has seen from few sides: its depth there is soft, and colours that are taken from other
photos by it come from beside the place that is meant. Most of what people build is flat, and triangulated points say
where, to a fraction of a pixel.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.planes import PLANE_PIXELS, Plane, fit_planes
from inpaint3d.scene.visibility import CoarseView

MAX_CHANGE = 0.15
"""Share by which a depth may change: where a ray grazes a plane it meets it anywhere."""
AVERAGED, NEAREST = 64, 16
"""Sparse points over which heights are averaged, for each is off by as much as what lies on a plane is high; and those
of them that tell the height of a place.
"""

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Relief:
    """A plane and what lies on it, a little higher here and there: a carpet, a sheet of paper.

    points: the sparse points [n, 3] within the plane's tolerance; with none it is the plane.
    """

    plane: Plane
    points: Array

    def depth(self, camera: Camera, pixels: Array, points: Array) -> Array:
        """Depth z at which a camera sees it at pixels [n, 2], as high as it is near points [n, 3]; inf where it does
        not.
        """
        heights = self._average(points, self._heights, NEAREST) if len(self.points) else 0.0
        return self.plane.depth(camera, pixels, heights)

    @cached_property
    def _heights(self) -> Array:
        return self._average(self.points, self.plane.height(self.points), AVERAGED)

    @cached_property
    def _tree(self) -> KDTree:
        return KDTree(self.points)

    def _average(self, places: Array, values: Array, count: int) -> Array:
        """Mean [m] of the `values` [n] of the sparse points nearest to `places` [m, 3], nearer ones counting more."""
        found = self._tree.query(places, min(count, len(self.points)))
        apart, nearest = (np.asarray(one).reshape(len(places), -1) for one in found)
        weights = 1.01 - (apart / np.maximum(apart[:, -1:], np.finfo(np.float64).tiny)) ** 2
        return (weights * values[nearest]).sum(-1) / weights.sum(-1)


@dataclass(frozen=True)
class FlatScene:
    """The planes of a scene with what lies on them, and how far a point of theirs may lie off them, scene units."""

    reliefs: Sequence[Relief]
    tolerance: float

    @classmethod
    def find(
        cls, views: Sequence[MaskedView], depths: Mapping[str, NDArray[np.float32]], points: NDArray[np.floating]
    ) -> "FlatScene":
        """In the sparse points [n, 3] of the views."""
        pixel = np.median([np.median(depths[v.name]) / v.camera.fx for v in views])
        tolerance, points = PLANE_PIXELS * float(pixel), points.astype(np.float64)
        planes = fit_planes(points, tolerance)
        return cls([Relief(plane, points[plane.distance(points) < tolerance]) for plane in planes], tolerance)

    @property
    def planes(self) -> list[Plane]:
        return [relief.plane for relief in self.reliefs]

    def snap(self, coarse: CoarseView, times: NDArray[np.floating] | float) -> CoarseView:
        """A view with what lies within so many `times` the tolerance of a plane on it."""
        return replace(coarse, depth=snap_to_planes(coarse.depth, coarse.camera, self.reliefs, times * self.tolerance))


def snap_to_planes(
    depth: NDArray[np.floating], camera: Camera, reliefs: Sequence[Relief], reach: NDArray[np.floating] | float
) -> NDArray[np.float32]:
    """A depth map z [h, w] with what lies within `reach` (scene units, of all or of each cell) of a plane on it.

    Cells are moved along their rays, to the nearest plane.
    """
    pixels = camera.pixel_centres().reshape(-1, 2)
    given = depth.reshape(-1).astype(np.float64)
    points = camera.unproject(pixels, given)
    nearest, moved = np.broadcast_to(reach, depth.shape).reshape(-1).copy(), given.copy()
    for relief in reliefs:
        apart = relief.plane.distance(points)
        near = np.flatnonzero(apart < nearest)
        there = relief.depth(camera, pixels[near], points[near])
        better = np.abs(there - given[near]) < MAX_CHANGE * given[near]
        nearest[near[better]], moved[near[better]] = apart[near[better]], there[better]
    return moved.reshape(depth.shape).astype(np.float32)
