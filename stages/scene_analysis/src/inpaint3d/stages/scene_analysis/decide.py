"""The decisions: measured figures against thresholds, in words."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Effect, LensModel
from inpaint3d.contracts.models.artifacts.effects import EffectName
from inpaint3d.scene.capture_io import SparsePoints, View
from inpaint3d.stages.scene_analysis.config import Config
from inpaint3d.stages.scene_analysis.lens import corner_displacement
from inpaint3d.stages.scene_analysis.photometry import Observations, direction_effect, view_gains

# Time of a training step with the effect, relative to one without: estimated from the operations that it adds.
COST: dict[EffectName, float] = {
    "contraction": 1.02,
    "lens-distortion": 1.0,  # paid once, when frames are undistorted
    "exposure": 1.05,
    "view-dependence": 1.3,
}
MIN_FAR_PAIRS = 200


def contraction(points: SparsePoints, config: Config) -> Effect:
    """Whether the scene reaches so far that a box round it would waste its cells on background."""
    radius = np.linalg.norm(points.xyz.astype(np.float64), axis=-1)
    far = float((radius > config.far_radius).mean()) if len(radius) else 1.0
    reach = float(np.quantile(radius, 0.99)) if len(radius) else 0.0
    wanted = far > config.far_share
    says = "more than" if wanted else "not more than"
    return _decide_effect(
        "contraction",
        wanted,
        {
            "share_beyond_far_radius": far,
            "share_outside_unit_ball": float((radius > 1).mean()) if len(radius) else 1.0,
            "radius_of_99_percent": reach,
        },
        f"{far:.1%} of the sparse points lie further than {config.far_radius:g} scene units from the point of "
        f"interest, {says} {config.far_share:.1%}; the scene is {'unbounded' if wanted else 'bounded'}",
        config,
    )


def lens_distortion(lens: LensModel, config: Config) -> Effect:
    """Whether the lens bends the picture visibly. Frames come undistorted either way."""
    moved = corner_displacement(lens)
    wanted = moved > config.distortion_px
    says = "more" if wanted else "not more"
    return _decide_effect(
        "lens-distortion",
        wanted,
        {"corner_displacement_px": moved},
        f"the {lens.model} lens moves the picture's corner by {moved:.2f} px, {says} than {config.distortion_px:g} px"
        + ("; pose estimation has undone it" if wanted else ""),
        config,
    )


def exposure(views: Sequence[View], seen: Observations, config: Config) -> tuple[Effect, NDArray[np.float64]]:
    """Whether views differ in brightness, by what their points look like; also each view's gain [views] in EV.

    The camera's own word (EXIF) decides only where too few points have usable colours: automatic exposure may follow a
    change of light, so that settings differ while the pictures don't.
    """
    gains = view_gains(seen, len(views))
    known = gains[np.isfinite(gains)]
    spread = _spread(known)
    said = [v.relative_exposure for v in views if v.relative_exposure is not None]
    by_exif = _spread(np.log2(said)) if said else 0.0
    evidence = {"gain_spread_ev": spread, "points": float(seen.points), "views_with_gain": float(len(known))}
    if said:
        evidence["exif_spread_ev"] = by_exif
    if seen.points >= config.min_tracks:
        wanted = spread > config.exposure_ev
        reason = f"the points' brightness differs between views by {spread:.2f} EV"
    else:
        wanted = by_exif > config.exposure_ev
        reason = f"only {seen.points} points have usable colours; exposures by EXIF differ by {by_exif:.2f} EV"
    says = "more than" if wanted else "not more than"
    effect = _decide_effect(
        "exposure", wanted, evidence, f"{reason} (10 to 90 % of views), {says} {config.exposure_ev:g} EV", config
    )
    return effect, np.where(np.isfinite(gains), gains, 0.0)


def view_dependence(
    views: Sequence[View], points: SparsePoints, seen: Observations, gains: NDArray[np.float64], config: Config
) -> Effect:
    """Whether surfaces change their brightness with the direction they are seen from, gains compensated."""
    centres = np.stack([v.camera.centre for v in views])
    near, far, pairs = direction_effect(seen, gains, points.xyz.astype(np.float64), centres)
    excess = float(np.sqrt(max(far**2 - near**2, 0.0)))
    evidence = {"near_ev": near, "far_ev": far, "excess_ev": excess, "far_pairs": float(pairs)}
    if pairs < MIN_FAR_PAIRS:
        # With too few pairs of views reflections may be there unseen: modelling one that is not there only costs time.
        reason = f"only {pairs} pairs of far apart views of one point tell of it, so that it cannot be ruled out"
        return _decide_effect("view-dependence", True, evidence, reason, config)
    wanted = excess > config.view_dependence_ev
    says = "more than" if wanted else "not more than"
    reason = (
        f"between far apart directions one pair in five differs in brightness by {excess:.2f} EV beyond noise, "
        f"{says} {config.view_dependence_ev:g} EV"
    )
    return _decide_effect("view-dependence", wanted, evidence, reason, config)


def _decide_effect(name: EffectName, wanted: bool, evidence: dict[str, float], reason: str, config: Config) -> Effect:
    forced = config.force.get(name)
    if forced is None:
        state = "on" if wanted else "off"
    else:
        state = "forced-on" if forced else "forced-off"
        reason = f"by parameter; measured: {reason}"
    return Effect(name=name, state=state, evidence=evidence, reason=reason, cost_ratio=COST[name])


def _spread(values: NDArray[np.float64]) -> float:
    """10 to 90 % of the values; 0 for none."""
    return float(np.diff(np.quantile(values, (0.1, 0.9)))[0]) if len(values) else 0.0
