"""The grain of a photo, and as much of it on what was filled: an enlarged or interpolated patch is too smooth."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.image_io import Mask
from inpaint3d.stages.plate_export.photo_files import Colours

# Immerkaer 1996 (doi:10.1006/cviu.1996.0060): the difference of two Laplacians leaves noise, six times as strong.
NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6
MEDIAN_OF_NORMAL = 0.6745
MIN_PIXELS = 100


def measure_grain(residual: NDArray[np.float32], where: Mask) -> float:
    """Standard deviation of noise, by the median of what `find_grain` left [h, w] of a picture; 0 for few pixels."""
    values = np.abs(residual[where])
    return float(np.median(values)) / MEDIAN_OF_NORMAL if len(values) >= MIN_PIXELS else 0.0


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
