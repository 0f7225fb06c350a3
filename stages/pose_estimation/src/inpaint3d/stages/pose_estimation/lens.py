"""Which lens model the capture supports: the simplest whose reprojection error is near the richest one's."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pycolmap

from inpaint3d.contracts.models.artifacts import Effect
from inpaint3d.scene.effects import lens_distortion
from inpaint3d.scene.effects.description import decide
from inpaint3d.stages.pose_estimation.features import silence_pycolmap

# Principal points are estimated with the richer models only: alone they trade off against the poses.
CANDIDATES = (("PINHOLE", False), ("SIMPLE_RADIAL", False), ("SIMPLE_RADIAL", True), ("OPENCV", True))
ENOUGH = 0.01  # share of the error that a richer model has to take away
ROUNDING_PX = 1e-6
# COLMAP's parameter orders: where k1 is found in each model that has it.
FIRST_RADIAL = {"SIMPLE_RADIAL": 3, "RADIAL": 3, "OPENCV": 4}
EXTRA = {"PINHOLE": 0, "SIMPLE_RADIAL": 1, "RADIAL": 2, "OPENCV": 4}


@dataclass(frozen=True)
class Trial:
    """A bundle-adjusted model with one lens model, and its root mean square reprojection error (px)."""

    lens: str
    centre: bool
    model: pycolmap.Reconstruction
    error_px: float

    @property
    def label(self) -> str:
        return f"{self.lens} {'with' if self.centre else 'without'} principal point"

    @property
    def described(self) -> lens_distortion.LensTrial:
        """As the effect compares it."""
        corner = max(measure_corner(camera) for camera in self.model.cameras.values())
        return lens_distortion.LensTrial(self.label, EXTRA[self.lens] + 2 * self.centre, self.error_px, corner)


@dataclass(frozen=True)
class Choice:
    """The model adjusted with the chosen lens, why in words, and the decision on whether it bends pictures."""

    model: pycolmap.Reconstruction
    why: str
    effect: Effect


def choose_lens(model: pycolmap.Reconstruction, lens: str, bends: bool | None = None) -> Choice:
    """A pinhole, unless a lens that bends is worth it; of those the simplest within ENOUGH of the best error.

    lens: a name, or "auto". bends: where somebody decided it.
    """
    candidates = CANDIDATES
    if lens != "auto":
        bends = lens != "PINHOLE"
        candidates = (CANDIDATES[0],) if lens == "PINHOLE" else (CANDIDATES[0], (lens, True))
    trials = [adjust_copy(model, name, centre) for name, centre in candidates]
    pinhole, bent = trials[0], trials[1:] or trials
    best = min(t.error_px for t in bent)
    simplest = next(t for t in bent if t.error_px <= best * (1 + ENOUGH))
    # Matches of one point share its error: points are what is independent, each with two coordinates.
    found = lens_distortion.measure(pinhole.described, simplest.described, 2.0 * len(model.points3D))
    effect = decide(lens_distortion.EFFECT, found, {} if bends is None else {lens_distortion.EFFECT.name: bends})
    chosen = simplest if effect.active else pinhole
    measured = "; ".join(f"{t.label} {t.error_px:.3f} px" for t in trials)
    why = "asked for by the parameter `lens`" if lens != "auto" else explain(effect.active)
    return Choice(chosen.model, f"{chosen.label}: {why} ({measured})", effect)


def describe_given(cameras: Iterable[pycolmap.Camera]) -> Effect:
    """The same of lenses that came with the capture: nothing is to be decided."""
    corner = max(measure_corner(camera) for camera in cameras)
    return Effect(
        name=lens_distortion.EFFECT.name,
        state="on" if corner > ROUNDING_PX else "off",
        evidence={"corner_px": corner},
        reason=f"came with the capture; moves the picture's corner by {corner:.2f} px",
        simulated_by=lens_distortion.EFFECT.simulated_by,
    )


def explain(bends: bool) -> str:
    """Why a lens was chosen, in words."""
    return f"the simplest within {ENOUGH:.0%} of the best error" if bends else "no lens that bends is worth it"


def adjust_copy(model: pycolmap.Reconstruction, lens: str, centre: bool) -> Trial:
    """A copy of the model with another lens model, bundle-adjusted."""
    copy = pycolmap.Reconstruction(model)
    for camera in copy.cameras.values():
        convert(camera, lens)
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = centre
    options.print_summary = False
    # One thread: more change the order of sums, and so the last digits.
    options.ceres.solver_options.num_threads = 1
    options.ceres.solver_options.function_tolerance = 1e-6
    # Mismatches that are left must not steer the lens.
    options.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    pycolmap.bundle_adjustment(copy, options)
    silence_pycolmap()  # the call above sets the log level back
    copy.update_point_3d_errors()
    return Trial(lens, centre, copy, root_mean_square(copy))


def measure_corner(camera: pycolmap.Camera) -> float:
    """How far a lens moves the picture's corners against its pinhole, the largest of the four; pixels as captured."""
    corners = np.array([(x, y) for x in (0, camera.width) for y in (0, camera.height)], np.float64)
    middle = (camera.principal_point_x, camera.principal_point_y)
    plane = (corners - middle) / (camera.focal_length_x, camera.focal_length_y)
    bent = np.asarray(camera.img_from_cam(np.concatenate([plane, np.ones((4, 1))], 1)))
    return float(np.linalg.norm(bent - corners, axis=1).max())


def convert(camera: pycolmap.Camera, lens: str) -> None:
    """Give a camera another model in place; what both know is kept, the rest starts at zero."""
    radial = FIRST_RADIAL.get(camera.model_name)
    k1 = camera.params[radial] if radial is not None else 0.0
    fx, fy = camera.focal_length_x, camera.focal_length_y
    focal = [fx, fy] if lens in ("PINHOLE", "OPENCV") else [(fx + fy) / 2]
    params = np.array([*focal, camera.principal_point_x, camera.principal_point_y, *[0.0] * EXTRA[lens]])
    if lens in FIRST_RADIAL:
        params[FIRST_RADIAL[lens]] = k1
    camera.model = pycolmap.CameraModelId.__members__[lens]
    camera.params = params.tolist()


def root_mean_square(model: pycolmap.Reconstruction) -> float:
    """Over the points' errors weighted by their observations, px."""
    errors = np.array([p.error for p in model.points3D.values()])
    lengths = np.array([p.track.length() for p in model.points3D.values()])
    return float(np.sqrt(np.sum(lengths * errors**2) / max(lengths.sum(), 1)))
