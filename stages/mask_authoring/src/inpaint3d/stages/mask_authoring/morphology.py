"""Closing, growing, shrinking and cleaning of masks, in pixels."""

import cv2
import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]


def disc(radius: int) -> NDArray[np.uint8]:
    """A structuring element: the pixels within `radius` of the middle one."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return (x * x + y * y <= radius * radius + radius).astype(np.uint8)


def grow(mask: Bools, radius: int) -> Bools:
    """Pixels within `radius` of the mask."""
    return cv2.dilate(mask.astype(np.uint8), disc(radius)).astype(bool) if radius > 0 else mask.copy()


def shrink(mask: Bools, radius: int) -> Bools:
    """Pixels deeper than `radius` inside the mask; the picture's border is no edge of it."""
    return cv2.erode(mask.astype(np.uint8), disc(radius)).astype(bool) if radius > 0 else mask.copy()


def close(mask: Bools, radius: int) -> Bools:
    """Fill gaps narrower than about 2 `radius`; nothing is taken away."""
    if radius <= 0:
        return mask.copy()
    # Padded, else what touches the border is not closed along it.
    padded = np.pad(mask, radius, mode="edge").astype(np.uint8)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, disc(radius))
    return closed[radius:-radius, radius:-radius].astype(bool) | mask


def fill_holes(mask: Bools, largest: float) -> Bools:
    """Fill enclosed gaps of at most `largest` times the mask's own area."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((~mask).astype(np.uint8), connectivity=4)
    small = [i for i in range(1, count) if stats[i, cv2.CC_STAT_AREA] <= largest * mask.sum()]
    height, width = mask.shape
    inner = [
        i
        for i in small
        if stats[i, cv2.CC_STAT_LEFT] > 0
        and stats[i, cv2.CC_STAT_TOP] > 0
        and stats[i, cv2.CC_STAT_LEFT] + stats[i, cv2.CC_STAT_WIDTH] < width
        and stats[i, cv2.CC_STAT_TOP] + stats[i, cv2.CC_STAT_HEIGHT] < height
    ]
    return mask | np.isin(labels, inner)


def without_specks(mask: Bools, smallest: float) -> Bools:
    """The parts of at least `smallest` times the largest part's area."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    areas = stats[1:, cv2.CC_STAT_AREA]
    return np.isin(labels, 1 + np.flatnonzero(areas >= smallest * areas.max())) if count > 1 else mask.copy()
