"""Many depth maps into one surface: a truncated signed distance volume (Curless and Levoy 1996) of contracted space.

Contracted, what is far away takes coarse cells and what is near takes fine ones, so that one grid holds the table and
the wall behind it. Distances are computed on a coarse grid first, and finely only in its blocks next to the surface.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, maximum_filter

from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.stages.usd_export.contraction import expand, measure_stretch

Floats = NDArray[np.float32]
Box = tuple[NDArray[np.float64], NDArray[np.float64]]

BLOCK = 4  # fine cells along a side of a coarse one
SLAB = 1 << 18  # points computed at once; bounds memory
BORDER = 0.06  # share of a picture's longest side
SMOOTHING = 0.8  # cells; standard deviation


@dataclass(frozen=True, eq=False)
class Volume:
    """Distances [x, y, z] at cell corners, in truncations: 1 free, 0 surface, -1 behind it, or not `known`."""

    low: NDArray[np.float64]
    cell: float
    distance: Floats
    known: NDArray[np.bool_]


def corners(low: NDArray[np.float64], high: NDArray[np.float64], grid: int) -> tuple[float, tuple[int, int, int]]:
    """Size of a cell, and the number of corners along each axis, for `grid` cells along the longest side."""
    sides = high - low
    cell = float(sides.max()) / grid
    x, y, z = (int(np.ceil(side / cell)) + 1 for side in sides)
    return cell, (max(x, 2), max(y, 2), max(z, 2))


def fuse(views: Sequence[SurfaceView], box: Box, *, grid: int, truncation_cells: float) -> Volume:
    """The views' signed distances along their axes, each cut at the truncation, averaged; what lies deeper is unseen.

    box: corners of contracted space. What lies behind surfaces and is seen by no other view counts as solid, so that
    the surface goes on there and has no cracks (section 4 of the paper). Corners far from any surface are not known.
    """
    cell, shape = corners(*box, grid)
    coarse_cell = cell * BLOCK
    coarse_shape = tuple(-(-n // BLOCK) for n in shape)
    # A coarse cell stands for all of its block: what lies within half a block's diagonal of it counts as near.
    coarse = np.empty(coarse_shape, np.float32)
    middles = np.indices(coarse_shape).reshape(3, -1).T
    for part in _slabs(len(middles)):
        points = box[0] + coarse_cell * (middles[part] + 0.5)
        coarse.reshape(-1)[part] = average_distance(views, points, truncation_cells * cell + coarse_cell)
    free, solid = (np.asarray(maximum_filter(side, 3), bool) for side in (coarse > 0, coarse < 0))
    near = (np.abs(coarse) < 1) | (free & solid)
    blocks = np.argwhere(maximum_filter(near, 3))
    inner = np.indices((BLOCK,) * 3).reshape(3, -1).T
    index = (blocks[:, None] * BLOCK + inner).reshape(-1, 3)
    index = index[(index < shape).all(1)]
    distance, known = np.zeros(shape, np.float32), np.zeros(shape, bool)
    for part in _slabs(len(index)):
        at = tuple(index[part].T)
        found = average_distance(views, box[0] + cell * index[part], truncation_cells * cell)
        known[at] = np.isfinite(found)
        distance[at] = np.where(known[at], found, 0.0)
    return Volume(box[0], cell, _smooth(distance, known), known)


def _smooth(distance: Floats, known: NDArray[np.bool_]) -> Floats:
    """Average out the depth maps' noise between neighbouring corners."""
    weight = gaussian_filter(known.astype(np.float32), SMOOTHING)
    summed = gaussian_filter(np.where(known, distance, np.float32(0)), SMOOTHING)
    return np.asarray(summed / np.maximum(weight, 1e-6), np.float32)


def average_distance(views: Sequence[SurfaceView], contracted: NDArray[np.float64], truncation: float) -> Floats:
    """Mean signed distance, in truncations, at contracted points [n, 3]; -1 behind surfaces, NaN unseen."""
    points = expand(contracted)
    band = truncation * measure_stretch(points)
    total, count = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
    hidden = np.zeros(len(points), bool)
    for view in views:
        ahead = depth_ahead(view, points) / band
        near = ahead > -1
        total += np.where(near, np.minimum(ahead, 1.0), 0.0)
        count += near
        hidden |= ~near & (ahead > -np.inf)
    return np.where(count > 0, total / np.maximum(count, 1.0), np.where(hidden, np.float32(-1), np.float32(np.nan)))


def depth_ahead(view: SurfaceView, points: NDArray[np.float64]) -> Floats:
    """How far behind each point [*n, 3] the view's surface lies along its axis; -inf where the view says nothing.

    The border's pixels speak for a strip around the picture too: cells that it cuts would be left out else.
    """
    camera = view.camera
    xy, z = camera.project(points)
    strip = BORDER * max(camera.width, camera.height)
    with np.errstate(invalid="ignore"):
        column, row = np.floor(xy[..., 0]), np.floor(xy[..., 1])
        inside = (z > 0) & (column >= -strip) & (column < camera.width + strip)
        inside &= (row >= -strip) & (row < camera.height + strip)
    column, row = (np.where(inside, at, 0).astype(np.int64) for at in (column, row))
    depth = view.depth[row.clip(0, camera.height - 1), column.clip(0, camera.width - 1)]
    return np.where(inside & (depth > 0), depth - z, -np.inf).astype(np.float32)


def _slabs(count: int) -> list[slice]:
    return [slice(start, start + SLAB) for start in range(0, count, SLAB)]
