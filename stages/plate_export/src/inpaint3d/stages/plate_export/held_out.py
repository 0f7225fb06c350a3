"""A view that completion did not see: its surface, and whose colours its hole shows, from the views that it saw."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO
from inpaint3d.scene.cameras import measure_apart
from inpaint3d.scene.membrane import span_membrane
from inpaint3d.scene.reprojection import sample_bilinear, sparse_depth
from inpaint3d.stages.plate_export.views import PlateView

NEIGHBOURS = 6
"""Views that a held-out one is completed from: those that look from nearest the same place and side."""


def complete_held_out(view: PlateView, views: Sequence[PlateView]) -> PlateView:
    """The view with disparity, sources and picture as completed views have them, seen from where it stands."""
    ranked = sorted(
        (i for i, v in enumerate(views) if v.completed),
        key=lambda i: measure_apart(view.camera.posed, views[i].camera.posed),
    )
    near = ranked[:NEIGHBOURS]
    h, w = views[near[0]].disparity.shape
    small = view.camera.posed.resize_to(w, h)
    depth = np.full((h, w), np.inf)
    for index in near:
        there = views[index]
        camera = there.camera.posed.resize_to(*there.disparity.shape[::-1])
        points = camera.unproject(camera.pixel_centres(), 1 / there.disparity)
        depth = np.minimum(depth, sparse_depth(small, points.reshape(-1, 3)))
    found = np.isfinite(depth)
    disparity = span_membrane(np.where(found, 1 / np.where(found, depth, 1.0), 0.0), found)
    # A lone cell is what a grazing view splats before the surface, or sees through its cracks.
    disparity = cv2.medianBlur(disparity.astype(np.float32), 3).astype(np.float64)
    return _take_colours(replace(view, disparity=disparity), near, views)


def _take_colours(view: PlateView, near: Sequence[int], views: Sequence[PlateView]) -> PlateView:
    """What photos know first, then what was filled in the nearest view that shows it."""
    y, x = np.nonzero(view.hole)
    camera = view.camera.posed
    rays = (np.stack([x + 0.5, y + 0.5], -1) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    points = view.camera.to_world(rays, view.disparity_at(rays))
    picture, sources = view.picture.copy(), view.sources.copy()
    for known in (True, False):
        for index in near:
            there = views[index]
            at, z = there.camera.to_rays(points)
            posed = there.camera.to_posed(at)
            usable = (sources[y, x] == 0) & there.sees(at, z)
            column, row = (np.where(usable, posed[:, axis], 0).astype(np.int64) for axis in (0, 1))
            code = there.sources[row, column]
            usable &= there.knows(at) if known else code > 0
            picture[y[usable], x[usable]] = sample_bilinear(there.picture, posed[usable])
            sources[y[usable], x[usable]] = FIRST_PHOTO + index if known else code[usable]
    return replace(view, picture=picture, sources=sources)
