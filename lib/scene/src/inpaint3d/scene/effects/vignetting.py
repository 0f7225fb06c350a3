"""Pictures that darken towards their corners: a radial term on top of the views' gains."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.gains import explained, measure_rest
from inpaint3d.scene.effects.intervals import GROUPS, jackknife, mean_of_folds, split_groups

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

EFFECT = Description(
    name="vignetting",
    what="pictures that darken towards their corners",
    evidence="radial term of the colours of tracks after the views' gains; what it explains of held-out points",
    off_means="pictures as they are",
    simulated_by=None,
    material=0.1,
    unit="EV from the middle to the corner",
    criterion="held-out points",
)
FEWEST_POINTS = 50
HUBER = 0.15


def measure(evidence: "Evidence") -> Finding:
    """How much darker the corner is than the middle (EV), by points that were seen in both."""
    if len(evidence.lit) < FEWEST_POINTS:
        return Finding(f"only {len(evidence.lit)} points have usable colours")
    values, square = evidence.even_luma, radius_squared(evidence)[evidence.lit]
    size = jackknife(lambda kept: fit_slope(values[kept], square[kept]), len(values), EFFECT.unit)
    group = split_groups(len(values))
    shares = [
        explained(
            measure_rest(values[group == g]),
            measure_rest(values[group == g] + fit_slope(values[group != g], square[group != g]) * square[group == g]),
        )
        for g in range(GROUPS)
    ]
    gain = mean_of_folds(np.array(shares), "share of the held-out spread")
    words = f"corners are darker than the middle by {size.value:.2f} EV ({size.low:.2f} to {size.high:.2f})"
    return Finding(words, size, gain, {"corner_ev": size.value})


def radius_squared(evidence: "Evidence") -> NDArray[np.float64]:
    """Squared distance of each point's pixel from the picture's middle [p, v], 1 in the corner."""
    size = np.array([(view.camera.width, view.camera.height) for view in evidence.views], np.float64)
    away = (evidence.xy - size / 2) / np.linalg.norm(size / 2, axis=-1)[:, None]
    return (away**2).sum(-1)


def fit_slope(values: NDArray[np.float64], square: NDArray[np.float64]) -> float:
    """How much brightness [p, v] falls with the squared radius [p, v], points' own brightness taken out (Huber)."""
    known = np.isfinite(values) & np.isfinite(square)
    weight, slope = known.astype(np.float64), 0.0
    x, y = np.where(known, square, 0.0), np.where(known, values, 0.0)
    for _ in range(6):
        total = np.maximum(weight.sum(1, keepdims=True), 1e-12)
        dx = x - (weight * x).sum(1, keepdims=True) / total
        dy = y - (weight * y).sum(1, keepdims=True) / total
        slope = float((weight * dx * dy).sum() / max((weight * dx * dx).sum(), 1e-12))
        rest = np.abs(dy - slope * dx)
        weight = np.where(known, np.minimum(1.0, HUBER / np.maximum(rest, HUBER)), 0.0)
    return -slope
