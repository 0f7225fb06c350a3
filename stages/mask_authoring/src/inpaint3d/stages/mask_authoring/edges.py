"""A mask's outline moved to where the picture changes: GrabCut at the picture's own size, in a narrow band."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.morphology import grow, shrink
from inpaint3d.stages.mask_authoring.segment import BACKGROUND, MAYBE_BACKGROUND, MAYBE_OBJECT, OBJECT, grabcut
from inpaint3d.stages.mask_authoring.views import DepthView

Bools = NDArray[np.bool_]

BAND = 0.006  # of the shorter side, to either side of the outline
NARROWEST = 2  # pixels


def refine_edges(view: DepthView, agreed: Bools, possible: Bools, rounds: int, seed: int) -> Bools:
    """The object on the picture [h, w]: what is well inside `agreed`, and of what is near `possible` as colours tell.

    Depth is left out: it is coarser than the picture, and would move outlines back to where it has them.
    """
    band = max(NARROWEST, round(BAND * min(agreed.shape)))
    trimap = np.full(agreed.shape, BACKGROUND, np.uint8)
    trimap[grow(possible, band)] = MAYBE_BACKGROUND
    trimap[agreed] = MAYBE_OBJECT
    trimap[shrink(agreed, band)] = OBJECT
    return grabcut(to_bytes(view.image()), trimap, rounds, seed)


def enlarge(mask: Bools, view: DepthView) -> Bools:
    """A mask from the segmentation's size to the picture's."""
    size = (view.camera.width, view.camera.height)
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) >= 0.5
