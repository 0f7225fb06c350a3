"""What is done to every mask that is not a volume, however it was found."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.morphology import close, fill_holes, grow

Bools = NDArray[np.bool_]

CLOSING = 0.01  # of the shorter side
HOLES = 0.05  # enclosed gaps up to this share of the mask are filled


def finish(mask: Bools, dilate: float) -> Bools:
    """Closed, small holes filled, grown by a share of the shorter side (M2: holes filled, edges smoothed)."""
    side = min(mask.shape)
    closed = fill_holes(close(mask, max(1, round(CLOSING * side))), HOLES)
    return grow(closed, round(dilate * side))
