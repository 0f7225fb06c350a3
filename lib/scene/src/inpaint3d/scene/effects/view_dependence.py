"""Surfaces whose colour changes with the direction they are seen from."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.intervals import GROUPS, jackknife, mean_of_folds, split_groups

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

Floats = NDArray[np.float64]

EFFECT = Description(
    name="view-dependence",
    what="colour that changes with the direction a surface is seen from",
    evidence="brightness of a point from far against near directions, gains taken out; whether a point's brightness is "
    "told better by the views near a held-out one than by all",
    off_means="the diffuse head alone; no encoding of directions, no specular network",
    simulated_by="inpaint3d.radiance.fields.RadianceField.specular",
    material=0.125,
    unit="EV between far directions beyond that between near ones",
    criterion="held-out views of a point",
)
NEAR_DEG, FAR_DEG = 6.0, 15.0
REACH_DEG = 8.0  # of the average over near directions
# Quantile of the pairs. A higher one would measure points at outlines: there another surface comes in between, the more
# often the further apart the views are.
QUANTILE = 0.8
FEWEST_PAIRS, FEWEST_POINTS = 200, 50
MAX_CELLS, MAX_VIEWS = 8_000_000, 120  # points times pairs of views; views, evenly spread
HUBER = 0.15


def measure(evidence: "Evidence") -> Finding:
    """What is Lambertian differs by noise alone, near and far directions alike; a reflection more the further apart."""
    count = len(evidence.views)
    some = np.unique(np.linspace(0, count - 1, min(count, MAX_VIEWS)).round().astype(np.int64))
    values, directions = evidence.even_luma[:, some], evidence.directions[evidence.lit][:, some]
    room = max(1, MAX_CELLS // max(1, values.shape[1] ** 2))
    values, directions = values[:room], directions[:room]
    group, difference, far = list_pairs(values, directions)
    pairs = int(far.sum())
    if pairs < FEWEST_PAIRS or len(values) < FEWEST_POINTS:
        # Reflections may be there unseen: modelling one that is not there only costs time.
        words = f"only {pairs} pairs of far apart views of {len(values)} points tell of it: it cannot be ruled out"
        return Finding(words, figures={"far_pairs": float(pairs)}, unknown=True)

    def excess(kept: NDArray[np.bool_]) -> float:
        mine = kept[group]
        near_ev, far_ev = (_measure_typical(difference[mine & where]) for where in (~far, far))
        return float(np.sqrt(max(far_ev**2 - near_ev**2, 0.0)))

    size = jackknife(excess, len(values), EFFECT.unit)
    gain = mean_of_folds(predict_by_neighbours(values, directions), "share of the held-out spread")
    figures = {"excess_ev": size.value, "far_pairs": float(pairs), "near_ev": _measure_typical(difference[~far])}
    words = (
        f"between far apart directions one pair in five differs by {size.value:.2f} EV (at least {size.low:.2f}) "
        f"beyond noise; near views tell {gain.value:.0%} more of a held-out one than all do"
    )
    return Finding(words, size, gain, figures)


def list_pairs(values: Floats, directions: Floats) -> tuple[NDArray[np.int64], Floats, NDArray[np.bool_]]:
    """Pairs of observations of one point that are near or far apart: point, |difference| in EV, whether far; each [n].

    values [p, v] in EV, NaN where unknown; directions [p, v, 3].
    """
    one, other = np.triu_indices(values.shape[1], 1)
    point: list[NDArray[np.int64]] = []
    difference: list[Floats] = []
    far: list[NDArray[np.bool_]] = []
    for first in range(0, len(values), 200):
        part = values[first : first + 200]
        gap = np.abs(part[:, one] - part[:, other])
        cosine = np.einsum("pvc,pvc->pv", directions[first : first + 200, one], directions[first : first + 200, other])
        apart, near = cosine < np.cos(np.deg2rad(FAR_DEG)), cosine > np.cos(np.deg2rad(NEAR_DEG))
        rows, columns = np.nonzero(np.isfinite(gap) & (apart | near))
        point.append(rows + first)
        difference.append(gap[rows, columns])
        far.append(apart[rows, columns])
    if not point:
        return np.zeros(0, np.int64), np.zeros(0), np.zeros(0, bool)
    return np.concatenate(point), np.concatenate(difference), np.concatenate(far)


def predict_by_neighbours(values: Floats, directions: Floats) -> Floats:
    """By how much less the views near a held-out one miss its brightness than all others do, per group of points.

    Each value of a point is predicted from the point's others: by their mean, and by their mean weighted by
    exp(-(angle / REACH_DEG)^2 / 2). Of a Lambertian point the second is the worse, of fewer values. 1 - ratio of
    losses.
    """
    known = np.isfinite(values)
    value = np.where(known, values, 0.0)
    loss = np.zeros((2, len(values)))
    for index in range(values.shape[1]):
        others = known.copy()
        others[:, index] = False
        cosine = np.einsum("pvc,pc->pv", directions, directions[:, index])
        near = others * np.exp((np.clip(cosine, -1, 1) - 1) / np.deg2rad(REACH_DEG) ** 2)  # 1 - cos x is x^2 / 2
        told = known[:, index] & (others.sum(1) >= 4) & (near.sum(1) > 0.5)
        for which, weight in enumerate((others, near)):
            guess = (weight * value).sum(1) / np.maximum(weight.sum(1), 1e-12)
            rest = np.abs(value[:, index] - guess)
            loss[which] += np.where(told, np.where(rest < HUBER, rest**2, HUBER * (2 * rest - HUBER)), 0.0)
    group = split_groups(len(values))
    totals = np.stack([loss[:, group == g].sum(1) for g in range(GROUPS)])
    return np.where(totals[:, 0] > 0, 1 - totals[:, 1] / np.maximum(totals[:, 0], 1e-12), np.nan)


def _measure_typical(values: Floats) -> float:
    return float(np.quantile(values, QUANTILE)) if values.size else 0.0
