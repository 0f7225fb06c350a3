"""Masked pixels lifted into space by the field's depth, and shown again in other views by a z-test."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.morphology import grow, grow_square
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TRIM = 0.005  # of the points at each end of each axis are taken for errors of the depth
RIM = 0.015  # of the shorter side: how far a mask's outline may be off
LARGEST_SPLAT = 24  # pixels; a point so near to a camera that it covers more is noise of the depth


@dataclass(frozen=True, eq=False)
class Cloud:
    """Surface points [n, 3] and the side of the surface patch that each stands for [n], scene units."""

    points: Floats
    sizes: Floats

    def __len__(self) -> int:
        return len(self.points)

    def select(self, keep: NDArray[np.bool_]) -> "Cloud":
        return Cloud(self.points[keep], self.sizes[keep])


def join(clouds: Sequence[Cloud]) -> Cloud:
    """All points together."""
    return Cloud(np.concatenate([c.points for c in clouds]), np.concatenate([c.sizes for c in clouds]))


def bounds(cloud: Cloud, room: float) -> tuple[Floats, Floats]:
    """The box (low [3], high [3]) round the cloud and, on every side, `room` times its longest side more.

    A few points at each end are left out: depth goes wrong along outlines.
    """
    low, high = np.quantile(cloud.points, TRIM, 0), np.quantile(cloud.points, 1 - TRIM, 0)
    more = max(room * float((high - low).max()), 2 * float(cloud.sizes.max()))
    return low - more, high + more


def are_near(points: Floats, cloud: Cloud, share: float) -> Bools:
    """Points [n, 3] in the cells of a grid that hold some of the cloud, or next to those.

    Cells are `share` of the cloud's longest side wide, so that "near" ends at once to twice that distance.
    """
    low, high = bounds(cloud, room=0.0)
    cell = share * float((high - low).max())
    counts = np.ceil((high - low) / cell).astype(int) + 3  # a rim of one cell, and what `bounds` left out

    def cells(xyz: Floats) -> NDArray[np.int64]:
        return np.floor((xyz - low) / cell).astype(np.int64) + 1

    held = np.zeros(counts, bool)
    inner = np.all((cloud.points >= low) & (cloud.points <= high), -1)
    held[tuple(cells(cloud.points[inner]).T)] = True
    for axis in range(3):
        shifted = [np.roll(held, step, axis) for step in (-1, 1)]
        held = held | shifted[0] | shifted[1]
    index = cells(points)
    within = np.all((index >= 0) & (index < counts), -1)
    within[within] = held[tuple(index[within].T)]
    return within


def lift(view: DepthView, mask: Bools) -> Cloud:
    """The surface under a mask [h, w], at the depth map's resolution; a cell counts if a quarter of it is masked."""
    camera = view.depth_camera
    at_depth = cv2.resize(mask.astype(np.float32), (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    rows, columns = np.nonzero((at_depth >= 0.25) & np.isfinite(view.depth))
    z = view.depth[rows, columns]
    xy = np.stack([columns, rows], -1) + 0.5
    return Cloud(camera.unproject(xy, z), z / camera.fx)


def splat(view: DepthView, cloud: Cloud, tolerance: float) -> Bools:
    """Pixels [h, w] of the picture in which the view sees some of the cloud.

    A point is seen where it is no further than `tolerance` (relative) behind the view's own surface. It covers a square
    of its size, so that neighbours leave no gaps between them.
    """
    camera = view.camera
    xy, z = camera.project(cloud.points)
    seen = camera.inside(xy, z)
    seen[seen] = z[seen] <= view.depth_at(xy[seen]) * (1 + tolerance)
    columns, rows = xy[seen].astype(np.int64).T
    side = np.clip(np.ceil(cloud.sizes[seen] * camera.fx / z[seen]).astype(int), 1, LARGEST_SPLAT)
    mask = np.zeros((camera.height, camera.width), bool)
    for pixels in np.unique(side):
        layer = np.zeros_like(mask)
        layer[rows[side == pixels], columns[side == pixels]] = True
        mask |= grow_square(layer, int(pixels) // 2)
    return mask


def votes(
    points: Floats, views: Sequence[DepthView], masks: Sequence[Bools], tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """How many of the views see each surface point [n] inside their mask, and how many outside it.

    A view sees a point where its own depth there is the point's, within `tolerance` (relative). Just outside a mask's
    outline, where depth and mask are uncertain, it says nothing.
    """
    inside, outside = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for view, mask in zip(views, masks, strict=True):
        clear_of_it = ~grow(mask, max(1, round(RIM * min(mask.shape))))
        xy, z = view.camera.project(points)
        index = np.flatnonzero(view.camera.inside(xy, z))
        own = view.depth_at(xy[index])
        index = index[np.abs(own - z[index]) <= tolerance * z[index]]
        columns, rows = xy[index].astype(np.int64).T
        inside[index] += mask[rows, columns]
        outside[index] += clear_of_it[rows, columns]
    return inside, outside
