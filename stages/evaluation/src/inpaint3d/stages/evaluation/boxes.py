"""The crop that hole metrics are taken on: the mask's bounding box, grown (conformance E1)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Box:
    """Pixels x0 <= x < x1, y0 <= y < y1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        return self.x1 - self.x0

    @property
    def height(self) -> int:
        return self.y1 - self.y0

    @property
    def slices(self) -> tuple[slice, slice]:
        """Rows and columns, to index an image [h, w, ...]."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    def grow(self, margin_x: int, margin_y: int, width: int, height: int) -> "Box":
        """The box with a margin on each side, cut to a picture of width x height."""
        return Box(
            max(0, self.x0 - margin_x),
            max(0, self.y0 - margin_y),
            min(width, self.x1 + margin_x),
            min(height, self.y1 + margin_y),
        )

    def relative_to(self, outer: "Box") -> "Box":
        """The same box in the pixel coordinates of `outer`, which contains it."""
        return Box(self.x0 - outer.x0, self.y0 - outer.y0, self.x1 - outer.x0, self.y1 - outer.y0)


def mask_box(mask: NDArray[np.bool_], growth: float) -> Box | None:
    """Bounding box of a mask [h, w], its width and height grown by the share `growth` (half on each side, rounded up).

    None for an empty mask. A 100-pixel-wide mask at a growth of 0.1 gives 110 pixels, less where the
    picture ends.
    """
    rows, columns = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    if rows.size == 0:
        return None
    tight = Box(int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    margin_x, margin_y = (int(np.ceil(side * growth / 2)) for side in (tight.width, tight.height))
    height, width = mask.shape
    return tight.grow(margin_x, margin_y, width, height)
