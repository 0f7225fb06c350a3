"""What an object stands on or hangs at: planes of the scene that it is no part of."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.morphology import grow, shrink
from inpaint3d.scene.planes import PLANE_PIXELS, Plane, fit_planes
from inpaint3d.stages.mask_authoring.cloud import votes
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

OWN = 0.1  # share of a plane's points seen on the object from which the plane may be the object's own
REACH = 0.008  # of the depth: how near a plane a surface lies on it; the field's depth is off by about half of that


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Planes, such as a table top or a wall, on which nothing new of the object is looked for."""

    planes: Sequence[Plane] = ()

    def show(self, view: DepthView) -> Bools:
        """Pixels [h, w] of a view's picture that show one of the planes."""
        shown = np.zeros((view.camera.height, view.camera.width), bool)
        for plane in self.planes:
            shown |= show_plane(plane, view)
        return shown

    def hold(self, points: Floats, view: DepthView) -> Bools:
        """Which points [n, 3] that a view sees lie on one of the planes."""
        held = np.zeros(len(points), bool)
        for plane in self.planes:
            held |= lie_on(plane, points, view)
        return held


def lie_on(plane: Plane, points: Floats, view: DepthView) -> Bools:
    """Which points [n, 3] that a view sees lie on a plane."""
    return plane.distance(points) < REACH * view.camera.project(points)[1]


def show_plane(plane: Plane, view: DepthView) -> Bools:
    """Pixels [h, w] of a view's picture that show a plane, in patches wider than a pixel of the depth map.

    A plane is broad. Single pixels on it are where depth is wrong, or steps from a thing to what is behind it: where
    such a step passes through a wall, the wall would show in the middle of what hangs at it.
    """
    xy = view.camera.pixel_centres()
    depth = view.depth_at(xy)
    known = np.isfinite(depth)
    on_it = np.zeros(depth.shape, bool)
    on_it[known] = lie_on(plane, view.camera.unproject(xy[known], depth[known]), view)
    radius = math.ceil(view.camera.width / view.depth.shape[1] / 2)
    return on_it & grow(shrink(on_it, radius), radius)


def find_planes(points: NDArray[np.float32], views: Sequence[DepthView]) -> list[Plane]:
    """The planes of a scene's sparse points [n, 3]; none where the field has no surface."""
    return fit_planes(points, PLANE_PIXELS * measure_pixel(views))


def find_surroundings(
    planes: Sequence[Plane],
    points: NDArray[np.float32],
    views: Sequence[DepthView],
    found: Mapping[int, Bools],
    tolerance: float,
) -> Surroundings:
    """The planes of sparse points [n, 3] that the object's masks in the views it was pointed at leave alone."""
    kept: list[Plane] = []
    for plane in planes:
        on_it = points[plane.distance(points.astype(np.float64)) < PLANE_PIXELS * measure_pixel(views)]
        inside, outside = votes(on_it.astype(np.float64), [views[i] for i in found], list(found.values()), tolerance)
        if (inside > 0).sum() < OWN * max(1, ((inside + outside) > 0).sum()):
            kept.append(plane)
    return Surroundings(kept)


def measure_pixel(views: Sequence[DepthView]) -> float:
    """How wide a pixel is at the middle of the depths, scene units; 0 where the field has no surface."""
    pixels = [float(np.median(v.depth[np.isfinite(v.depth)])) / v.camera.fx for v in views if _sees(v)]
    return float(np.median(pixels)) if pixels else 0.0


def _sees(view: DepthView) -> bool:
    return bool(np.isfinite(view.depth).any())
