"""What each view did to all that it shows: value[point, view] = a[point] + g[view] + rest, fitted robustly."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Interval
from inpaint3d.scene.effects.intervals import GROUPS, mean_of_folds, split_groups

Floats = NDArray[np.float64]
ROUNDS = 12
HUBER = 0.15  # EV; residuals beyond this are outliers rather than noise


def fit_gains(values: Floats, huber: float = HUBER, start: Floats | None = None) -> Floats:
    """Gain g of each view [v] of values [p, v] (NaN: unknown), median 0; 0 for a view that no value ties to others.

    Least squares, reweighted against outliers (Huber), with the points' own a[p] eliminated: what remains is one small
    dense system over the views (the Schur complement of bundle adjustment). start: gains to begin with, for fewer
    rounds.
    """
    known = np.isfinite(values)
    value = np.where(known, values, 0.0)
    weight = known.astype(np.float64)
    gains = np.zeros(values.shape[1])
    for index in range((ROUNDS if start is None else ROUNDS // 3) if known.any() else 0):
        total = np.maximum(weight.sum(1), 1e-12)
        if index == 0 and start is not None:
            gains = start
        else:
            share = weight / total[:, None]
            system = np.diag(weight.sum(0)) - weight.T @ share
            right = (weight * value).sum(0) - share.T @ (weight * value).sum(1)
            gains = np.linalg.lstsq(system, right, rcond=1e-9)[0]
        own = ((weight * (value - gains)).sum(1)) / total
        rest = np.abs(value - own[:, None] - gains)
        weight = np.where(known, np.minimum(1.0, huber / np.maximum(rest, huber)), 0.0)
    told = known.any(0)
    return np.where(told, gains - (np.median(gains[told]) if told.any() else 0.0), 0.0)


def fit_channels(values: Floats) -> Floats:
    """`fit_gains` of each channel: values [p, v, c] -> [v, c]."""
    return np.stack([fit_gains(values[..., c]) for c in range(values.shape[-1])], -1)


def measure_rest(values: Floats, huber: float = HUBER) -> Floats:
    """Huber's loss of values [p, v] about their points' means; NaN for points with fewer than two values."""
    known = np.isfinite(values)
    count = known.sum(1)
    mean = np.where(known, values, 0.0).sum(1) / np.maximum(count, 1)
    rest = np.where(known, np.abs(values - mean[:, None]), 0.0)
    loss = np.where(rest < huber, rest**2, huber * (2 * rest - huber)).sum(1)
    # n values about their own mean have n - 1 degrees of freedom.
    return np.where(count > 1, loss / np.maximum(count - 1, 1), np.nan)


def explained(before: Floats, after: Floats) -> float:
    """Share of a loss that is gone; NaN where there was none."""
    total = np.nansum(before)
    return float(1 - np.nansum(after) / total) if total > 0 else float("nan")


def fit_folds(values: Floats, huber: float = HUBER) -> tuple[Floats, Floats, Interval]:
    """Gains of all [v] and without each group of points [GROUPS, v]; the share of the spread about the points' means
    that gains explain on points they were not fitted to.
    """
    group = split_groups(len(values))
    every = fit_gains(values, huber)
    without = np.stack([fit_gains(values[group != g], huber, start=every) for g in range(GROUPS)])
    shares = [
        explained(measure_rest(held := values[group == g], huber), measure_rest(held - without[g], huber))
        for g in range(GROUPS)
    ]
    return every, without, mean_of_folds(np.array(shares), "share of the held-out spread")
