"""A visual hull in voxels: what all masks agree on, carried to views that have none, and joined to the others."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.morphology import shrink
from inpaint3d.stages.mask_authoring.cloud import Cloud, bounds, join, lift
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

RIM = 0.008  # of the shorter side
STRIDE = 8
GROWTH = (
    0.3  # of the object's size: the grid reaches this far beyond its seen surface, since no view may show its underside
)


def carve(
    views: Sequence[DepthView], masks: Sequence[Bools], *, voxels: int, agreement: float, tolerance: float
) -> Cloud:
    """Voxel centres [n, 3] and sizes of the object that the masks outline (Laurentini, PAMI 1994, with votes).

    Kept is what lies inside the masks of `agreement` of the views that can tell. A view cannot tell where it has the
    voxel outside its mask but behind its own surface: something else stands in front. What more views have hidden than
    inside is dropped: it is below the floor or in the wall.
    """
    centres, side = _grid(*bounds(_surface(views, masks), room=GROWTH), voxels)
    counts = np.zeros((len(centres), 3), np.int16)  # inside, outside, hidden
    for index in _spread(len(views)):
        # The first few views rule out most voxels, which the other views then skip.
        alive = counts[:, 1] <= (1 - agreement) * len(views)
        centres, counts = centres[alive], counts[alive]
        _count(views[index], masks[index], centres, counts, tolerance)
    inside, outside, hidden = counts.T
    keep = (inside > 0) & (inside >= agreement * (inside + outside)) & (inside >= hidden)
    if not keep.any():
        raise BadInputError(
            "the masks of the views have no volume in common: they are of different objects, or the cameras or the "
            "field's depth are wrong; look at the masks and at nerf-pretraining's depth, or lower `agreement`"
        )
    return Cloud(centres[keep], np.full(int(keep.sum()), side))


def _count(view: DepthView, mask: Bools, centres: Floats, counts: NDArray[np.int16], tolerance: float) -> None:
    """Add what one view says of each voxel [n, 3] to its counts [n, 3]: inside, outside, hidden."""
    xy, z = view.camera.project(centres)
    index = np.flatnonzero(view.camera.inside(xy, z))
    columns, rows = xy[index].astype(np.int64).T
    behind = z[index] > view.depth_at(xy[index]) * (1 + tolerance)
    counts[index, np.where(mask[rows, columns], 0, np.where(behind, 2, 1))] += 1


def _spread(count: int) -> list[int]:
    """0 to count - 1, views far from each other first."""
    return [i for start in range(STRIDE) for i in range(start, count, STRIDE)]


def _surface(views: Sequence[DepthView], masks: Sequence[Bools]) -> Cloud:
    """What the views see under their masks; the masks' rims, where depth may be the background's, are left out."""
    rims = [max(1, round(RIM * min(m.shape))) for m in masks]
    inner = [shrink(m, rim) for m, rim in zip(masks, rims, strict=True)]
    # A thin object's mask is rim everywhere: then the whole mask counts.
    cloud = join([lift(v, i if i.any() else m) for v, i, m in zip(views, inner, masks, strict=True)])
    if not len(cloud):
        raise BadInputError(
            "no masked pixel of any view has a surface in the pretrained field; train it longer "
            "(nerf-pretraining) or mask something that it reconstructs"
        )
    return cloud


def _grid(low: Floats, high: Floats, voxels: int) -> tuple[Floats, float]:
    """Voxel centres [n, 3] of a regular grid with `voxels` cells along its longest side, and the cells' side."""
    side = float((high - low).max()) / voxels
    counts = np.maximum(np.ceil((high - low) / side).astype(int), 1)
    axes = [start + side * (np.arange(n) + 0.5) for start, n in zip(low, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3), side
