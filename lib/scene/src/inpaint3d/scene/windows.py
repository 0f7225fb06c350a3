"""Square windows of a view that overlap its hole, with known pixels around it: what a prior is shown (row S1)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.masked_views import MaskedView


@dataclass(frozen=True)
class Window:
    """A square of `size` x `size` rays in one view, `spacing` pixels apart; (x, y) is its upper left corner, pixels."""

    view: int
    x: float
    y: float
    spacing: float
    size: int

    def pixels(self) -> NDArray[np.float32]:
        """Centres of its cells in pixel coordinates (centres at +0.5), [size, size, 2] as (x, y)."""
        steps = (np.arange(self.size, dtype=np.float32) + 0.5) * np.float32(self.spacing)
        xx, yy = np.meshgrid(self.x + steps, self.y + steps)
        return np.stack([xx, yy], -1).astype(np.float32)

    def sample(self, image: NDArray[np.generic]) -> NDArray[np.generic]:
        """The pixels of `image` [h, w, ...] that hold the cells' centres, [size, size, ...]."""
        xy = np.floor(self.pixels()).astype(np.int64)
        h, w = image.shape[:2]
        return image[np.clip(xy[..., 1], 0, h - 1), np.clip(xy[..., 0], 0, w - 1)]


def compute_window_side(span: float, size: int, height: int, width: int) -> int:
    """Side in whole pixels of a window over `span` of the short side, at least one pixel a ray, within the picture."""
    short = min(height, width)
    return min(short, max(size, round(span * short)))


def sum_boxes(mask: NDArray[np.bool_], side: int) -> NDArray[np.int64]:
    """How many pixels of `mask` [h, w] every side x side window holds, [h - side + 1, w - side + 1]."""
    table = np.pad(mask.astype(np.int64).cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    return table[side:, side:] - table[:-side, side:] - table[side:, :-side] + table[:-side, :-side]


def draw_window(
    hole: NDArray[np.bool_],
    known: NDArray[np.bool_],
    view: int,
    *,
    size: int,
    span: float,
    min_known: float,
    rng: np.random.Generator | None,
) -> Window | None:
    """A random window that overlaps `hole` [h, w] and of which `known` [h, w] fills at least the share `min_known`.

    Windows are drawn in proportion to the hole that they cover, since the rest of a window only tells the prior where
    it is. Where no window of this span holds enough known pixels the one with the most is taken; None only where the
    view has no hole at all. Without `rng` it is the middle one of those that cover most of the hole. Where its rays
    are further apart than the hole is wide, and all of them miss it, a smaller one whose rays miss no pixel is taken.
    """
    side = compute_window_side(span, size, *hole.shape)
    covered = sum_boxes(hole, side).astype(np.float64)
    if not covered.any():
        return None
    context = sum_boxes(known, side)
    enough = np.maximum(1, min_known * side * side)
    odds = np.where(context >= enough, covered, 0.0)
    if not odds.any():
        odds = np.where((covered > 0) & (context == context[covered > 0].max()), covered, 0.0)
    if rng is None:
        best = np.flatnonzero(odds == odds.max())
        chosen = int(best[len(best) // 2])
    else:
        cumulative = odds.ravel().cumsum()
        chosen = int(np.searchsorted(cumulative, rng.random() * cumulative[-1], side="right"))
    y, x = np.unravel_index(min(chosen, odds.size - 1), odds.shape)
    window = Window(view, float(x), float(y), side / size, size)
    if side > size and not window.sample(hole).any():
        return draw_window(hole, known, view, size=size, span=0.0, min_known=min_known, rng=rng)
    return window


def choose_fixed_windows(
    views: Sequence[MaskedView], *, size: int, span: float, min_known: float
) -> list[Window | None]:
    """One window of each view, over most of its hole; None where it shows none, or nothing known around it."""
    return [
        draw_window(v.hole, v.known, i, size=size, span=span, min_known=min_known, rng=None) if v.known.any() else None
        for i, v in enumerate(views)
    ]
