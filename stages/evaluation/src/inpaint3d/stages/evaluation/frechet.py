"""Distances between two sets of feature vectors: Frechet (as in FID) and the kernel distance (as in KID)."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Features = NDArray[np.float64]


class Estimate(NamedTuple):
    """A figure and its standard error; None where there are too few vectors to tell."""

    value: float
    standard_error: float | None


def frechet_distance(a: Features, b: Features) -> float:
    """Squared Frechet distance of the Gaussians fitted to a [n, d] and b [m, d] (arXiv:1706.08500, eq. 6).

    |mean_a - mean_b|^2 + tr(C_a + C_b - 2 (C_a C_b)^(1/2)). With centred rows A / sqrt(n - 1), whose
    products are the covariances, the trace of the root is the sum of the singular values of A B^T: an n x m
    problem, exact where n < d makes the covariances rank deficient. With few rows the value is mostly bias:
    compare sets of equal size only. Raises ValueError for fewer than two rows.
    """
    for name, rows in (("first", a), ("second", b)):
        if len(rows) < 2:
            raise ValueError(f"a Frechet distance needs at least 2 vectors in each set; the {name} has {len(rows)}")
    centred_a, centred_b = (_subtract_mean(rows) for rows in (a, b))
    between = np.sum((a.mean(0) - b.mean(0)) ** 2)
    root_trace = np.linalg.svd(_multiply_rows(centred_a, centred_b), compute_uv=False).sum()
    return float(max(0.0, between + np.sum(centred_a**2) + np.sum(centred_b**2) - 2.0 * root_trace))


def kernel_distance(a: Features, b: Features) -> float:
    """The value of `estimate_kernel_distance` alone."""
    return estimate_kernel_distance(a, b).value


def estimate_kernel_distance(a: Features, b: Features) -> Estimate:
    """Unbiased squared maximum mean discrepancy, kernel (x.y / d + 1)^3 (KID, arXiv:1801.01401, eq. 4).

    Being unbiased, it may fall below 0 for sets of one distribution. The standard error is the jackknife's over the
    vectors of both sets, which needs three of each. Raises ValueError for fewer than two rows.
    """
    n, m = len(a), len(b)
    if min(n, m) < 2:
        raise ValueError(f"a kernel distance needs at least 2 vectors in each set; there are {n} and {m}")

    def kernel(x: Features, y: Features) -> NDArray[np.float64]:
        return (_multiply_rows(x, y) / x.shape[1] + 1.0) ** 3

    within_a, within_b, between = kernel(a, a), kernel(b, b), kernel(a, b)
    # a vector paired with itself is what would make the estimate biased
    pairs_a, pairs_b = (within.sum(1) - np.diag(within) for within in (within_a, within_b))
    mean_a, mean_b = pairs_a.sum() / (n * (n - 1)), pairs_b.sum() / (m * (m - 1))
    value = float(mean_a + mean_b - 2.0 * between.mean())
    if min(n, m) < 3:
        return Estimate(value, None)
    without_a = _leave_one_out(pairs_a) + mean_b - 2.0 * (between.sum() - between.sum(1)) / ((n - 1) * m)
    without_b = mean_a + _leave_one_out(pairs_b) - 2.0 * (between.sum() - between.sum(0)) / (n * (m - 1))
    variance = sum((len(w) - 1) / len(w) * np.sum((w - w.mean()) ** 2) for w in (without_a, without_b))
    return Estimate(value, float(np.sqrt(variance)))


def _leave_one_out(pairs: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean over the pairs of a set that leave out each vector, from the sum of each vector's pairs [n]."""
    n = len(pairs)
    return (pairs.sum() - 2.0 * pairs) / ((n - 1) * (n - 2))


def _multiply_rows(x: Features, y: Features) -> NDArray[np.float64]:
    """X y^T, row by row: a matrix product is shared out over threads, and each share rounds by itself."""
    return np.array([[np.sum(a * b) for b in y] for a in x])


def _subtract_mean(rows: Features) -> Features:
    return (rows - rows.mean(0)) / np.sqrt(len(rows) - 1)
