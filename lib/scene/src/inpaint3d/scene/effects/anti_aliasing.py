"""Surfaces that are seen from near and from far: their pixels cover areas of very different sizes."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.intervals import GROUPS, jackknife, mean_of_folds, split_groups

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

EFFECT = Description(
    name="anti-aliasing",
    what="surfaces seen from near and from far",
    evidence="spread of the pixels' footprints on a point's surface over the views that show it",
    off_means="point samples along rays",
    simulated_by=None,
    material=1.5,
    unit="octaves between the largest and smallest footprint of a point, 90 % of the points",
    criterion="held-out points",
)
FEWEST_POINTS = 50


def measure(evidence: "Evidence") -> Finding:
    """Octaves of footprint that nine points in ten stay below."""
    octaves = list_octaves(evidence)
    octaves = octaves[np.isfinite(octaves)]
    if len(octaves) < FEWEST_POINTS:
        return Finding(f"only {len(octaves)} points tell how large the pixels are on surfaces")
    size = jackknife(lambda kept: float(np.quantile(octaves[kept], 0.9)), len(octaves), EFFECT.unit)
    group = split_groups(len(octaves))
    beyond = np.array([np.quantile(octaves[group == g], 0.9) - EFFECT.material for g in range(GROUPS)])
    words = f"of one point in ten pixels differ in size by more than {size.value:.2f} octaves"
    return Finding(words, size, mean_of_folds(beyond, "octaves"), {"octaves": size.value})


def list_octaves(evidence: "Evidence") -> NDArray[np.float64]:
    """log2 of the largest over the smallest footprint of each point [p]; NaN for those seen once."""
    focal = np.array([np.sqrt(view.camera.fx * view.camera.fy) for view in evidence.views])
    centres = np.stack([view.camera.centre for view in evidence.views])
    footprint = np.log2(np.linalg.norm(evidence.xyz[:, None] - centres, axis=-1) / focal)
    low = np.where(evidence.tracked, footprint, np.inf).min(1)
    high = np.where(evidence.tracked, footprint, -np.inf).max(1)
    return np.where(evidence.tracked.sum(1) > 1, high - low, np.nan)
