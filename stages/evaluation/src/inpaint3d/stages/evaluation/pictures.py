"""Pictures for people: outlined masks, coloured depth, panels side by side."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.stages.evaluation.baselines import ring_around

OUTLINE = np.array([1.0, 0.22, 0.42], np.float32)
BROKEN = np.array([1.0, 0.0, 1.0], np.float32)
DIFFERENCE_GAIN = 4
GAP = 4  # pixels of white between panels

# Near is light and warm, far is dark: read at a glance, and still ordered in grey.
_RAMP = np.array(
    [
        (0.99, 0.93, 0.63), (0.98, 0.70, 0.38), (0.87, 0.41, 0.41), (0.61, 0.26, 0.49), (0.34, 0.18, 0.46),
        (0.10, 0.09, 0.23),
    ],
    np.float64,
)  # fmt: skip


def outline_hole(image: Image, mask: Mask) -> Image:
    """The picture [h, w, 3] with the mask [h, w] tinted and its border drawn."""
    thickness = max(1, round(min(mask.shape) / 160))
    border = ring_around(mask, thickness)
    tinted = np.where(mask[..., None], 0.72 * image + 0.28 * OUTLINE, image)
    return np.where(border[..., None], OUTLINE, tinted).astype(np.float32)


def hide_hole(image: Image, mask: Mask) -> Image:
    """The picture with the mask in the outline's colour: what the method may look at."""
    return np.where(mask[..., None], OUTLINE, image).astype(np.float32)


def colour_depth(depth: NDArray[np.float32]) -> Image:
    """A depth map [h, w] as a picture; the ramp is even in inverse depth between its 2 % and 98 % quantiles.

    Depth that is not positive is drawn in mid grey.
    """
    valid = np.isfinite(depth) & (depth > 0)
    if not valid.any():
        return np.full((*depth.shape, 3), 0.5, np.float32)
    inverse = 1.0 / np.where(valid, depth, 1.0)
    far, near = np.quantile(inverse[valid], [0.02, 0.98])
    position = np.clip((near - inverse) / max(near - far, 1e-9), 0.0, 1.0) * (len(_RAMP) - 1)
    lower = np.minimum(position.astype(np.int64), len(_RAMP) - 2)
    share = (position - lower)[..., None]
    colours = _RAMP[lower] * (1 - share) + _RAMP[lower + 1] * share
    return np.where(valid[..., None], colours, 0.5).astype(np.float32)


def colour_difference(image: Image, truth: Image) -> Image:
    """How far two pictures [h, w, 3] in [0, 1] differ at each pixel, mean over channels: black is equal, white far.

    The difference is enlarged, so that white is a quarter of the range.
    """
    apart = np.abs(image.astype(np.float64) - truth).mean(-1, keepdims=True)
    return np.broadcast_to(np.clip(apart * DIFFERENCE_GAIN, 0, 1), image.shape).astype(np.float32)


def set_side_by_side(panels: list[Image]) -> Image:
    """Panels of one size in a row, with white between them. Pixels that are not finite are drawn in magenta."""
    height = panels[0].shape[0]
    gap = np.ones((height, GAP, 3), np.float32)
    shown = [np.where(np.isfinite(p).all(-1, keepdims=True), p, BROKEN) for p in panels]
    row = [part for panel in shown for part in (panel, gap)][:-1]
    return np.concatenate(row, axis=1)


def choose_clearest_view(holes: list[Mask]) -> int:
    """Index of the view whose hole is largest among those that lie wholly inside the picture; else the largest."""
    sizes = [int(hole.sum()) for hole in holes]
    whole = [
        not (hole[0].any() or hole[-1].any() or hole[:, 0].any() or hole[:, -1].any()) and hole.any() for hole in holes
    ]
    candidates = [i for i, inside in enumerate(whole) if inside] or list(range(len(holes)))
    return max(candidates, key=lambda i: sizes[i])
