"""Growing, shrinking, closing and cleaning of masks: boolean [h, w], radii in pixels."""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from inpaint3d.scene.image_io import Mask


def grow(mask: Mask, radius: int) -> Mask:
    """Pixels within about `radius` of the mask: those that a disc of that radius reaches, see `reach_of_disc`.

    One pixel more reaches the eight neighbours of a pixel.
    """
    if radius <= 0 or not mask.any():
        return mask.copy()
    out, near = np.zeros_like(mask), _find_window(mask, radius)
    out[near] = np.asarray(ndimage.distance_transform_edt(~mask[near])) < reach_of_disc(radius)
    return out


def shrink(mask: Mask, radius: int) -> Mask:
    """Pixels deeper than about `radius` inside the mask; the picture's border is no edge of it."""
    if radius <= 0 or mask.all() or not mask.any():
        return mask.copy()
    out, near = np.zeros_like(mask), _find_window(mask, 1)
    out[near] = np.asarray(ndimage.distance_transform_edt(mask[near])) > reach_of_disc(radius)
    return out


def reach_of_disc(radius: int) -> float:
    """Distance in pixels that a disc of a radius stays below: x^2 + y^2 <= radius^2 + radius, which looks round."""
    # Squared distances are whole numbers, so that a slack of 0.5 changes no decision and absorbs the rounding of sqrt.
    return float(np.sqrt(radius * radius + radius + 0.5))


def grow_square(mask: Mask, radius: int) -> Mask:
    """Pixels at most `radius` rows and columns from the mask."""
    if radius <= 0 or not mask.any():
        return mask.copy()
    return np.asarray(ndimage.maximum_filter(mask, size=2 * radius + 1, mode="constant", cval=0), bool)


def close(mask: Mask, radius: int) -> Mask:
    """Fill gaps narrower than about 2 `radius`; nothing is taken away."""
    if radius <= 0:
        return mask.copy()
    # Padded, else what touches the border is not closed along it.
    padded = np.pad(mask, radius, mode="edge")
    return shrink(grow(padded, radius), radius)[radius:-radius, radius:-radius] | mask


def fill_holes(mask: Mask, max_share: float) -> Mask:
    """Fill enclosed gaps of at most `max_share` times the mask's own area."""
    labels, count = label_parts(~mask, diagonal=False)
    small = part_areas(labels, count) <= max_share * mask.sum()
    at_border = np.unique(np.concatenate([labels[[0, -1]].ravel(), labels[:, [0, -1]].ravel()]))
    small[at_border] = False
    small[0] = False
    return mask | small[labels]


def remove_specks(mask: Mask, min_share: float) -> Mask:
    """The parts of at least `min_share` times the largest part's area."""
    labels, count = label_parts(mask)
    areas = part_areas(labels, count)
    areas[0] = 0
    return mask & (areas >= min_share * areas.max())[labels]


def keep_parts_at(mask: Mask, pixels: NDArray[np.integer]) -> Mask:
    """The parts of the mask that hold one of `pixels` (column, row) [n, 2]."""
    labels, count = label_parts(mask)
    kept = np.zeros(count + 1, bool)
    kept[labels[pixels[:, 1], pixels[:, 0]]] = True
    return mask & kept[labels]


def label_parts(mask: Mask, *, diagonal: bool = True) -> tuple[NDArray[np.int32], int]:
    """A number from 1 on for each connected part [h, w], 0 outside the mask; and how many parts there are.

    diagonal: pixels that touch in a corner are connected.
    """
    labels = np.empty(mask.shape, np.int32)
    ndimage.label(mask, np.ones((3, 3)) if diagonal else None, output=labels)
    return labels, int(labels.max())


def part_areas(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Pixels of each part by its number, [count + 1]; of what lies outside, at 0."""
    return np.bincount(labels.ravel(), minlength=count + 1)


def _find_window(mask: Mask, margin: int) -> tuple[slice, slice]:
    """Rows and columns of the mask's bounding box and `margin` pixels around it: distances cost by the pixel."""
    spans = (np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0)))
    rows, columns = (slice(max(0, s[0] - margin), s[-1] + 1 + margin) for s in spans)
    return rows, columns
