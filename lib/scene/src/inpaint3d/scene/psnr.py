"""PSNR, and its mean over views: one definition for learning curves, metrics, doubts and exports."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Colours = NDArray[np.floating]


def psnr(image: Colours, truth: Colours, region: NDArray[np.bool_] | None = None) -> float:
    """Peak signal-to-noise ratio, dB, of values in [0, 1] over `region` (bool [h, w]; None: everywhere) and channels.

    Infinite for equal pictures: `mean_psnr` keeps that out of means. NaN where a value is not finite. Raises ValueError
    where the region is empty or the shapes differ.
    """
    if image.shape != truth.shape:
        raise ValueError(f"pictures to compare are {image.shape} and {truth.shape}; both must be of one shape")
    squared = np.square(image.astype(np.float64) - truth)
    if region is not None:
        squared = squared[region]
    if squared.size == 0:
        raise ValueError("PSNR over no pixel: the region is empty")
    mean = float(squared.mean())
    if not math.isfinite(mean):
        return math.nan
    return -10.0 * math.log10(mean) if mean > 0 else math.inf


def mean_psnr(values: Iterable[float]) -> float | None:
    """Mean of the PSNR of several views, dB, without those that equal the truth; None where none is left.

    A large number in place of an infinite one would make one equal view outweigh all others. NaN stays NaN.
    """
    kept = [value for value in values if not math.isinf(value)]
    return math.fsum(kept) / len(kept) if kept else None
