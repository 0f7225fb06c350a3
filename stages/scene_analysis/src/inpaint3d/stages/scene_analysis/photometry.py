"""Brightness of the sparse points along their tracks: what each view's exposure did to it, and what direction did.

Each observation of a point p in a view v is modelled as  log2 L = a[p] + g[v] + r : the point's brightness, the view's
gain (EV), and a rest that holds noise, and view-dependent reflection.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.capture_io import SparsePoints, View
from inpaint3d.scene.colour import linear_from_srgb, luma
from inpaint3d.scene.reprojection import sample_bilinear

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

DARKEST, BRIGHTEST = 0.03, 0.95  # sRGB; below is noise, above some channel is clipped
MAX_POINTS = 4000
ROUNDS = 12
HUBER_EV = 0.15  # residuals beyond this are outliers rather than noise
NEAR_DEG, FAR_DEG = 6.0, 15.0
# Quantile of the pairs. A higher one would measure points at outlines: there another surface comes in between, the more
# often the further apart the views are.
QUANTILE = 0.8
PAIRS = 200_000


@dataclass(frozen=True, eq=False)
class Observations:
    """Brightness of points in views: point [t], view [t] (indices), log2_luma [t] (EV, linear light)."""

    point: Indices
    view: Indices
    log2_luma: Floats

    @property
    def points(self) -> int:
        return len(np.unique(self.point))


def observe(views: Sequence[View], points: SparsePoints) -> Observations:
    """Usable brightness along the tracks: neither clipped nor nearly black, and seen in at least two views."""
    lengths = np.diff(points.track_offsets)
    # The longest tracks say most about gains; ties in the points' own order.
    chosen = np.argsort(-lengths, kind="stable")[:MAX_POINTS]
    rows = np.flatnonzero(np.isin(points.track_point, chosen))
    brightness = np.full(len(rows), np.nan)
    for index in np.unique(points.track_frame[rows]):
        mine = np.flatnonzero(points.track_frame[rows] == index)
        colour = sample_bilinear(views[index].image(), points.track_xy[rows[mine]]).astype(np.float64)
        usable = (colour.max(-1) < BRIGHTEST) & (colour.min(-1) > DARKEST)
        brightness[mine] = np.where(usable, np.log2(luma(linear_from_srgb(np.maximum(colour, DARKEST)))), np.nan)
    point, view = points.track_point[rows], points.track_frame[rows].astype(np.int64)
    usable = np.isfinite(brightness)
    seen = np.bincount(point[usable], minlength=len(points))
    kept = usable & (seen[point] >= 2)
    return Observations(point[kept], view[kept], brightness[kept])


def view_gains(seen: Observations, views: int) -> Floats:
    """Gain g of each view [views] in EV, median 0; NaN for a view that no observation ties to the others.

    Least squares, reweighted against outliers (Huber), with the points' brightness eliminated: what remains is one
    small dense system over the views (the Schur complement of bundle adjustment).
    """
    point = np.unique(seen.point, return_inverse=True)[1]
    count = int(point.max()) + 1 if len(point) else 0
    gains, weight = np.zeros(views), np.ones(len(point))
    for _ in range(ROUNDS if count else 0):
        table, value = np.zeros((count, views)), np.zeros((count, views))
        np.add.at(table, (point, seen.view), weight)
        np.add.at(value, (point, seen.view), weight * seen.log2_luma)
        per_point = table.sum(1)
        share = table / per_point[:, None]
        system = np.diag(table.sum(0)) - table.T @ share
        gains = np.linalg.lstsq(system, value.sum(0) - share.T @ value.sum(1), rcond=1e-9)[0]
        brightness = (value.sum(1) - table @ gains) / per_point
        rest = np.abs(seen.log2_luma - brightness[point] - gains[seen.view])
        weight = np.minimum(1.0, HUBER_EV / np.maximum(rest, HUBER_EV))
    told = np.isin(np.arange(views), seen.view)
    return np.where(told, gains - (np.median(gains[told]) if told.any() else 0.0), np.nan)


def direction_effect(
    seen: Observations, gains: Floats, xyz: Floats, centres: Floats, seed: int = 0
) -> tuple[float, float, int]:
    """How much a point's brightness differs between near and between far viewing directions.

    xyz [p, 3], camera centres [views, 3]. Returns the difference (EV) that QUANTILE of the pairs of observations of
    one point less than NEAR_DEG apart stay below, the same for pairs more than FAR_DEG apart, and how many far pairs
    there were. What is Lambertian differs by noise alone, equally in both; a reflection more the further apart.
    """
    first, second = _draw_pairs(seen, np.random.default_rng(seed))
    value = seen.log2_luma - gains[seen.view]
    difference = np.abs(value[first] - value[second])
    ray = centres[seen.view] - xyz[seen.point]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    angle = np.rad2deg(np.arccos(np.clip(np.sum(ray[first] * ray[second], -1), -1, 1)))
    near, far = angle < NEAR_DEG, angle > FAR_DEG
    return _measure_typical(difference[near]), _measure_typical(difference[far]), int(far.sum())


def _draw_pairs(seen: Observations, rng: np.random.Generator) -> tuple[Indices, Indices]:
    """Random pairs of different observations of one point; with short tracks the same pair may come twice."""
    order = np.argsort(seen.point, kind="stable")
    _, start, count = np.unique(seen.point[order], return_index=True, return_counts=True)
    if not len(start):
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    each = np.repeat(np.arange(len(start)), np.minimum(count * (count - 1) // 2, 4 * count))
    if len(each) > PAIRS:
        each = rng.choice(each, PAIRS, replace=False)
    one = rng.integers(0, count[each])
    other = (one + rng.integers(1, count[each])) % count[each]
    return order[start[each] + one], order[start[each] + other]


def _measure_typical(values: Floats) -> float:
    return float(np.quantile(values, QUANTILE)) if values.size else 0.0
