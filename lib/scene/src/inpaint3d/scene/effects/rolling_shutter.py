"""Rows that were exposed one after the other while the camera moved."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.intervals import GROUPS, jackknife, mean_of_folds, split_groups

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

Floats = NDArray[np.float64]

EFFECT = Description(
    name="rolling-shutter",
    what="rows exposed one after the other by a moving camera",
    evidence="reprojection residuals against row times image velocity, of captures in order",
    off_means="a global shutter",
    simulated_by=None,
    material=0.05,
    unit="share of the time between frames that a picture takes to be read",
    criterion="held-out points",
)
FEWEST = 500
HUBER_PX = 1.0


def measure(evidence: "Evidence") -> Finding:
    """The readout time that the residuals support. Poses that took part of the skew up hide part of it."""
    if not evidence.ordered or len(evidence.views) < 3:
        return Finding("the photos have no order in time, so that nothing tells how fast the camera moved")
    residual, skew = list_skews(evidence)
    known = np.isfinite(residual).all(-1) & np.isfinite(skew).all(-1)
    if known.sum() < FEWEST:
        return Finding(f"only {int(known.sum())} matches lie between a view before and one behind")
    size = jackknife(lambda kept: fit_readout(residual[kept], skew[kept]), len(residual), EFFECT.unit)
    group = split_groups(len(residual))
    folds = [
        _measure_gain(residual[group == g], skew[group == g], fit_readout(residual[group != g], skew[group != g]))
        for g in range(GROUPS)
    ]
    gain = mean_of_folds(np.array(folds), "share of the held-out residuals")
    words = (
        f"residuals support a readout of {size.value:.3f} of the time between frames "
        f"({size.low:.3f} to {size.high:.3f})"
    )
    return Finding(words, size, gain, {"readout_share": size.value})


def list_skews(evidence: "Evidence") -> tuple[Floats, Floats]:
    """Residuals [p, v, 2], and what a readout of a whole frame's time would do to each match [p, v, 2], pixels."""
    height = np.array([view.camera.height for view in evidence.views], np.float64)
    ahead = np.full_like(evidence.xy, np.nan)
    # Image velocity by the cameras on both sides; the first and the last view have one.
    for index in range(1, len(evidence.views) - 1):
        before, after = (_project(evidence, index, other) for other in (index - 1, index + 1))
        ahead[:, index] = (after - before) / 2
    share = evidence.xy[..., 1] / height - 0.5
    return evidence.residual, share[..., None] * ahead


def _project(evidence: "Evidence", index: int, other: int) -> Floats:
    """Pixels of all points in a view of the camera `index` put where `other` stood."""
    own = evidence.views[index].camera
    moved = replace(own, world_from_cam=evidence.views[other].camera.world_from_cam)
    xy, z = moved.project(evidence.xyz)
    return np.where(z[:, None] > 0, xy, np.nan)


def fit_readout(residual: Floats, skew: Floats) -> float:
    """The multiple of `skew` that explains `residual` best (Huber), both [p, v, 2]."""
    known = np.isfinite(residual).all(-1) & np.isfinite(skew).all(-1)
    r, s = residual[known], skew[known]
    weight, readout = np.ones(len(r)), 0.0
    for _ in range(6):
        readout = float((weight[:, None] * r * s).sum() / max((weight[:, None] * s * s).sum(), 1e-12))
        rest = np.linalg.norm(r - readout * s, axis=-1)
        weight = np.minimum(1.0, HUBER_PX / np.maximum(rest, HUBER_PX))
    return readout


def _measure_gain(residual: Floats, skew: Floats, readout: float) -> float:
    known = np.isfinite(residual).all(-1) & np.isfinite(skew).all(-1)
    before, after = (
        np.minimum(np.linalg.norm(residual[known] - part * skew[known], axis=-1), 3 * HUBER_PX) ** 2
        for part in (0.0, readout)
    )
    return float(1 - after.sum() / before.sum()) if before.sum() > 0 else float("nan")
