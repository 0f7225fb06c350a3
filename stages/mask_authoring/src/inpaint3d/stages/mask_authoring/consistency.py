"""How well the masks of neighbouring views agree about the surfaces that both see."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.reprojection import reproject_mask
from inpaint3d.stages.mask_authoring.segment import iou
from inpaint3d.stages.mask_authoring.views import DepthView, camera_distances

Bools = NDArray[np.bool_]

NEIGHBOURS = 4  # views that a view's mask is compared with, nearest first
LOW = 0.6  # IoU; a view's mean below this is for a person to look at. Good masks, rims grown, are at 0.8 and more


@dataclass(frozen=True)
class Agreement:
    """set: mean IoU with the nearest view's mask; views: of each view, with those of its nearest ones, mean.

    None where no pair has masked surface in common.
    """

    set: float | None
    views: Sequence[float | None]

    def to_check(self, names: Sequence[str]) -> tuple[str, ...]:
        """Names of the views that agree little with their neighbours."""
        return tuple(n for n, score in zip(names, self.views, strict=True) if score is not None and score < LOW)


def measure_agreement(views: list[DepthView], masks: list[Bools], tolerance: float) -> Agreement:
    """Each view's mask against its neighbours', carried into it by depth, over what both see.

    At the depth maps' resolution.
    """
    apart = camera_distances([v.camera for v in views])
    np.fill_diagonal(apart, np.inf)
    small = [_at_depth_size(v, m) for v, m in zip(views, masks, strict=True)]
    nearest: list[float] = []
    each: list[float | None] = []
    for i, row in enumerate(apart):
        others = np.argsort(row, kind="stable")[: min(NEIGHBOURS, len(views) - 1)]
        scores = [compare(views[i], small[i], views[j], small[j], tolerance) for j in others]
        nearest += [s for s in scores[:1] if s is not None]
        known = [s for s in scores if s is not None]
        each.append(float(np.mean(known)) if known else None)
    return Agreement(float(np.mean(nearest)) if nearest else None, each)


def compare(view: DepthView, mask: Bools, other: DepthView, others: Bools, tolerance: float) -> float | None:
    """IoU of a view's mask with another's carried into it; both at their depth maps' size. None: neither shows any."""
    carried, seen = reproject_mask(others, other.depth_camera, other.depth, view.depth_camera, view.depth, tolerance)
    both = mask & seen
    return iou(carried, both) if (carried | both).any() else None


def _at_depth_size(view: DepthView, mask: Bools) -> Bools:
    height, width = view.depth.shape
    return cv2.resize(mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA) >= 0.5
