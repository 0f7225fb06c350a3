"""The mask as a volume that a person can see in the scene: its primitives, or the hull of its views."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask
from inpaint3d.stages.usd_export.fusion import Volume, corners
from inpaint3d.stages.usd_export.mesh import Mesh, extract

AGREEMENT = 0.8


def visual_hull(
    cameras: Sequence[Camera],
    masks: Sequence[Mask],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    grid: int,
) -> Mesh:
    """The part of the box [low, high] that lies in the mask [h, w] of at least 80 % of the views that look at it.

    At least two views must look. Empty where no such part is.
    """
    cell, shape = corners(low, high, grid)
    axes = [low[k] + cell * np.arange(shape[k]) for k in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    inside, seen = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for camera, mask in zip(cameras, masks, strict=True):
        xy, z = camera.project(points)
        looked = camera.inside(xy, z)
        column, row = np.where(looked[..., None], xy, 0).astype(np.int64).transpose(3, 0, 1, 2)
        inside += mask[row, column] & looked
        seen += looked
    share = np.where(seen >= 2, inside / np.maximum(seen, 1), 0.0)
    # Voxels at the border of the grid count as outside, so that the hull is a closed surface.
    share = np.pad(share, 1)
    distance = (AGREEMENT - share - 1e-6).astype(np.float32)
    return extract(Volume(low - cell, cell, distance, np.ones(distance.shape, bool)))
