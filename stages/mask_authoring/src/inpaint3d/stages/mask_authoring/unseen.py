"""What of each mask no other view shows either: the smaller hole that has to be made up."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.reprojection import sparse_depth
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.scene.visibility import enlarge_cells, shrink_holes
from inpaint3d.stages.mask_authoring.cloud import lift
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SUPPORT = 2  # other views that must show a surface for it to be known
COARSER = 2  # than the depth maps, so that few cells between the points of other views stay without one
LOOKED_AT = 16  # views whose surfaces may be the one behind
WITNESSES = 8  # views that are asked whether a ray passes through air
STEPS = 16  # places on the ray
NEAREST, FARTHEST = 0.3, 0.97  # of the way to the surface behind: where the first and the last of them lie
BEHIND = 0.01  # of the depth: so far behind a view's surface nothing is known


def find_unseen(views: Sequence[DepthView], masks: Sequence[Bools]) -> list[Bools]:
    """Of each view's mask [h, w] what fewer than two other views show, once what is masked is gone.

    The surface behind a masked pixel is the nearest that other views have outside their masks. It counts only where the
    way to it leads through air that some view looks through, or through what is masked: below a table top that the
    object hides, the floor behind is not what would be seen.
    """
    blank = np.zeros((1, 1, 3), np.float32)
    masked = [MaskedView(v.name, v.camera, blank, m, ~m) for v, m in zip(views, masks, strict=True)]
    surfaces = [lift(v, ~m).points for v, m in zip(views, masks, strict=True)]
    depths = {v.name: look_behind(i, views, masks, surfaces) for i, v in enumerate(views)}
    return [reduced.hole for reduced in shrink_holes(masked, depths, SUPPORT)]


def look_behind(
    index: int, views: Sequence[DepthView], masks: Sequence[Bools], surfaces: Sequence[Floats]
) -> NDArray[np.float32]:
    """A view's depth map z with, under its mask, the surface behind; where that is not known, the field's own.

    surfaces: points [n, 3] that each view sees outside its mask.
    """
    view = views[index]
    height, width = view.depth.shape
    others = [i for i in range(len(views)) if i != index]
    camera = view.camera.resize_to(max(1, width // COARSER), max(1, height // COARSER))
    seen = [np.zeros((0, 3)), *(surfaces[i] for i in choose_evenly(others, LOOKED_AT))]
    column, row = _pixels_of(view)
    masked = masks[index][row, column]
    behind = sparse_depth(camera, np.concatenate(seen))
    behind[~enlarge_cells(masked, behind.shape)] = np.inf
    witnesses = [(views[i], masks[i]) for i in choose_evenly(others, WITNESSES)]
    behind[~pass_through_air(camera, behind, witnesses)] = np.inf
    hidden = enlarge_cells(behind, view.depth.shape)
    own = np.where(np.isfinite(view.depth), view.depth, _far(view.depth))
    return np.where(masked & np.isfinite(hidden), hidden, own).astype(np.float32)


def pass_through_air(camera: Camera, depth: Floats, others: Sequence[tuple[DepthView, Bools]]) -> Bools:
    """Which cells [h, w] have nothing unknown before the surface at `depth` z, as other views with their masks tell."""
    clear = np.isfinite(depth)
    row, column = np.nonzero(clear)
    ends = camera.unproject(np.stack([column, row], -1) + 0.5, depth[row, column]) - camera.centre
    for share in np.linspace(NEAREST, FARTHEST, STEPS):
        points = camera.centre + share * ends
        asked, free = np.zeros(len(points), bool), np.zeros(len(points), bool)
        for view, mask in others:
            xy, z = view.camera.project(points)
            here = np.flatnonzero(view.camera.inside(xy, z))
            x, y = xy[here].astype(np.int64).T
            here, x, y = (values[~mask[y, x]] for values in (here, x, y))
            asked[here] = True
            free[here] |= z[here] <= view.depth_at(xy[here]) * (1 + BEHIND)
        clear[row[asked & ~free], column[asked & ~free]] = False
    return clear


def _pixels_of(view: DepthView) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Column and row of the picture's pixels at the centres of the depth map's cells, [h', w'] each."""
    height, width = view.depth.shape
    xy = view.depth_camera.pixel_centres() * (view.camera.width / width, view.camera.height / height)
    column, row = xy.astype(np.int64).transpose(2, 0, 1)
    return column, row


def _far(depth: Floats) -> float:
    """A depth behind all surfaces of a view."""
    known = depth[np.isfinite(depth)]
    return 10 * float(known.max()) if known.size else 1.0
