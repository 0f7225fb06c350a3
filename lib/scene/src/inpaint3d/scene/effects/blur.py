"""Frames that a moving camera, or a wrong focus, blurred."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.gains import fit_folds
from inpaint3d.scene.effects.intervals import from_parts

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

EFFECT = Description(
    name="blur",
    what="frames blurred by motion or focus",
    evidence="each view's loss of fine against coarse detail at the same points, against the other views; what it "
    "explains of held-out points",
    off_means="all frames are evidence",
    simulated_by="inpaint3d.scene.evidence_masks.IgnoredPixels",
    material=0.3,
    unit="octaves of detail that the most blurred frame lacks",
    criterion="held-out points",
)
FEWEST_POINTS = 50
LARGEST_SHARE = 0.25  # of the frames may be left out; the others have to carry the scene
HUBER = 0.5  # octaves


def measure(evidence: "Evidence") -> Finding:
    """How much less detail the most blurred view shows than the median one, of the same points."""
    values = list_values(evidence)
    if len(values) < FEWEST_POINTS or values.shape[1] < 4:
        return Finding(f"only {len(values)} points in {values.shape[1]} views tell how sharp each is")
    every, without, gain = fit_folds(values, HUBER)
    worst = int(np.argmin(every))
    size = from_parts(-float(every[worst]), -without[:, worst], EFFECT.unit)
    left_out = find_blurred(evidence)
    words = (
        f"the most blurred view, {evidence.views[worst].name}, lacks {size.value:.2f} octaves of detail (at least "
        f"{size.low:.2f}); {len(left_out)} lack more than {EFFECT.material:g}"
    )
    figures = {"worst_octaves": size.value, "views_left_out": float(len(left_out))}
    return Finding(words, size, gain, figures, {"detail": tuple(every.round(4).tolist())})


def list_values(evidence: "Evidence") -> NDArray[np.float64]:
    """Sharpness [points seen in several views, v] where a point should be seen; NaN elsewhere."""
    values = np.where(evidence.expected, evidence.sharpness, np.nan)
    return values[np.isfinite(values).sum(1) >= 3]


def find_blurred(evidence: "Evidence") -> list[str]:
    """Names of the training views that are more blurred than is worth their place, the most blurred first.

    Never more than LARGEST_SHARE of them go.
    """
    values = list_values(evidence)
    if len(values) < FEWEST_POINTS or values.shape[1] < 4:
        return []
    every, without, _ = fit_folds(values, HUBER)
    certain = [from_parts(-float(every[v]), -without[:, v], "").low > EFFECT.material for v in range(len(every))]
    trains = np.array([view.split == "train" for view in evidence.views])
    chosen: list[int] = []
    for index in np.argsort(every):
        room = len(chosen) < LARGEST_SHARE * trains.sum()
        if room and certain[index] and trains[index]:
            chosen.append(int(index))
    return [evidence.views[index].name for index in chosen]
