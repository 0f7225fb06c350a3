"""Many depth maps into one surface: a truncated signed distance volume (Curless and Levoy 1996)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.stages.usd_export.surface_views import SurfaceView

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Volume:
    """Distances [x, y, z] at cell corners, in truncations: 1 free, 0 surface, -1 behind it; weight 0: never seen."""

    low: NDArray[np.float64]
    cell: float
    distance: Floats
    weight: Floats


def corners(low: NDArray[np.float64], high: NDArray[np.float64], grid: int) -> tuple[float, tuple[int, int, int]]:
    """Size of a cell, and the number of corners along each axis, for `grid` cells along the longest side."""
    sides = high - low
    cell = float(sides.max()) / grid
    x, y, z = (int(np.ceil(side / cell)) + 1 for side in sides)
    return cell, (max(x, 2), max(y, 2), max(z, 2))


def fuse(
    views: Sequence[SurfaceView],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    *,
    grid: int,
    truncation_cells: float,
) -> Volume:
    """Average the views' signed distances along their axes, each cut at the truncation; what lies deeper is unseen.

    Works through the volume in slabs of constant x, so that memory beyond the result is that of one slab.
    """
    cell, shape = corners(low, high, grid)
    truncation = cell * truncation_cells
    distance, weight = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    y, z = np.meshgrid(low[1] + cell * np.arange(shape[1]), low[2] + cell * np.arange(shape[2]), indexing="ij")
    for i in range(shape[0]):
        points = np.stack([np.full_like(y, low[0] + cell * i), y, z], -1)
        total, count = np.zeros(shape[1:], np.float32), np.zeros(shape[1:], np.float32)
        for view in views:
            ahead = depth_ahead(view, points)
            near = ahead > -truncation
            total += np.where(near, np.minimum(ahead / truncation, 1.0), 0.0)
            count += near
        distance[i] = total / np.maximum(count, 1.0)
        weight[i] = count
    return Volume(low, cell, distance, weight)


def depth_ahead(view: SurfaceView, points: NDArray[np.float64]) -> Floats:
    """How far behind each point [*n, 3] the view's surface lies along its axis; -inf where the view says nothing."""
    xy, z = view.camera.project(points)
    inside = view.camera.inside(xy, z)
    column, row = np.where(inside[..., None], xy, 0).astype(np.int64).transpose(-1, *range(xy.ndim - 1))
    depth = view.depth[row, column]
    return np.where(inside & (depth > 0), depth - z, -np.inf).astype(np.float32)
