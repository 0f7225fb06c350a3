"""Confidence intervals from ten groups of points: an estimate without each group in turn (the jackknife)."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Interval

Floats = NDArray[np.float64]
GROUPS = 10
SPREAD = 2.262  # two-sided 95 % of Student's t with GROUPS - 1 degrees of freedom


def split_groups(count: int) -> NDArray[np.int64]:
    """The group [count] of each point, at random, of one size: neighbours in the list may be neighbours in space."""
    return np.random.default_rng(0).permutation(count) % GROUPS


def jackknife(estimate: Callable[[NDArray[np.bool_]], float], count: int, unit: str) -> Interval:
    """An estimate over `count` points, each time told which points to keep (bool [count]), and its 95 % interval."""
    group = split_groups(count)
    return from_parts(estimate(np.ones(count, bool)), np.array([estimate(group != g) for g in range(GROUPS)]), unit)


def from_parts(value: float, without: Floats, unit: str) -> Interval:
    """value: the estimate of all; without [GROUPS]: the estimate without each group."""
    deviation = float(np.sqrt((GROUPS - 1) / GROUPS * np.sum((without - without.mean()) ** 2)))
    return Interval(value=value, low=value - SPREAD * deviation, high=value + SPREAD * deviation, unit=unit)


def mean_of_folds(folds: Floats, unit: str) -> Interval:
    """The mean of figures measured on each group after it was held out, [GROUPS], and its 95 % interval."""
    folds = folds[np.isfinite(folds)]
    if len(folds) < 2:
        return Interval(value=0.0, low=0.0, high=0.0, unit=unit)
    mean, error = float(folds.mean()), float(folds.std(ddof=1) / np.sqrt(len(folds)))
    return Interval(value=mean, low=mean - SPREAD * error, high=mean + SPREAD * error, unit=unit)
