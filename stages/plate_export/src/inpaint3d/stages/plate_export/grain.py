"""The grain of a photo, and as much of it on what was filled: an enlarged or interpolated patch is too smooth."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.image_io import Mask
from inpaint3d.stages.plate_export.photo_files import Colours

# Immerkaer 1996 (doi:10.1006/cviu.1996.0060): the difference of two Laplacians leaves noise, six times as strong.
NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
MEAN_OF_NORMAL = 0.7979
"""Mean absolute value of a standard normal variable."""
BLOCK = 9
"""Pixels: side of the squares over which noise is averaged."""
SMOOTHEST = 0.2
"""Share of the squares that count: where there is least, there is no texture in it."""
MIN_PIXELS = 100


def measure_grain(residual: NDArray[np.float32], where: Mask) -> float:
    """Standard deviation of noise, from what `find_grain` left [h, w] of a picture; 0 for few pixels."""
    if where.sum() < MIN_PIXELS:
        return 0.0
    share = cv2.boxFilter(where.astype(np.float32), -1, (BLOCK, BLOCK))
    mean = cv2.boxFilter(np.where(where, np.abs(residual), np.float32(0)), -1, (BLOCK, BLOCK))
    values = (mean / np.maximum(share, 1e-6))[where]
    return float(np.quantile(values, SMOOTHEST)) / MEAN_OF_NORMAL


def find_grain(colours: Colours) -> NDArray[np.float32]:
    """The noise of the mean of the channels [h, w, c], and of its texture what is as fine."""
    return np.asarray(cv2.filter2D(colours.mean(-1), -1, NOISE, borderType=cv2.BORDER_REFLECT), np.float32)


def add_grain(
    colours: Colours, labels: NDArray[np.int64], ring: Mask, rng: np.random.Generator
) -> tuple[Colours, float]:
    """Colours [h, w, c] with what each part of `labels` [h, w] (from 0 on) lacks of the ring's grain; and that."""
    residual = find_grain(colours)
    wanted = measure_grain(residual, ring)
    missing = np.zeros(labels.shape, np.float32)
    for label in np.unique(labels[labels >= 0]):
        part = labels == label
        inner = cv2.erode(part.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
        missing[part] = np.sqrt(max(0.0, wanted**2 - measure_grain(residual, inner) ** 2))
    noise = rng.standard_normal(labels.shape, np.float32) * missing
    return (colours + noise[..., None]).astype(np.float32), wanted
