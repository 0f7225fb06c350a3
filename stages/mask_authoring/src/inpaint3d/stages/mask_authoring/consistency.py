"""How well the masks of neighbouring views agree about the surfaces that both see."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.reprojection import reproject_mask
from inpaint3d.stages.mask_authoring.segment import iou
from inpaint3d.stages.mask_authoring.views import DepthView, camera_distances

Bools = NDArray[np.bool_]


def measure_consistency(views: list[DepthView], masks: list[Bools], tolerance: float) -> float | None:
    """Mean IoU of each view's mask with its nearest neighbour's mask reprojected into it, over what both see.

    At the depth maps' resolution. None where no pair has masked surface in common.
    """
    if len(views) < 2:
        return None
    apart = camera_distances([v.camera for v in views])
    np.fill_diagonal(apart, np.inf)
    small = [_at_depth_size(v, m) for v, m in zip(views, masks, strict=True)]
    scores = []
    for i, j in enumerate(np.argmin(apart, 1)):
        view, other = views[i], views[j]
        carried, seen = reproject_mask(
            small[j], other.depth_camera, other.depth, view.depth_camera, view.depth, tolerance
        )
        if (carried | (small[i] & seen)).any():
            scores.append(iou(carried, small[i] & seen))
    return float(np.mean(scores)) if scores else None


def _at_depth_size(view: DepthView, mask: Bools) -> Bools:
    height, width = view.depth.shape
    return cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5
