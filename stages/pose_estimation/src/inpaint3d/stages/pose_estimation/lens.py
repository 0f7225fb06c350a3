"""Which lens model the capture supports: the simplest whose reprojection error is near the richest one's."""

from dataclasses import dataclass

import numpy as np
import pycolmap

from inpaint3d.stages.pose_estimation.features import silence_pycolmap

# Principal points are estimated with the richer models only: alone they trade off against the poses.
CANDIDATES = (("PINHOLE", False), ("SIMPLE_RADIAL", False), ("SIMPLE_RADIAL", True), ("OPENCV", True))
ENOUGH = 0.01  # share of the error that a richer model has to take away
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


def choose_lens(model: pycolmap.Reconstruction, lens: str) -> tuple[pycolmap.Reconstruction, str]:
    """The model adjusted with the chosen lens, and the evidence in words. `lens`: a name, or "auto"."""
    candidates = CANDIDATES if lens == "auto" else ((lens, lens != "PINHOLE"),)
    trials = [adjust_copy(model, name, centre) for name, centre in candidates]
    best = min(t.error_px for t in trials)
    chosen = next(t for t in trials if t.error_px <= best * (1 + ENOUGH))
    measured = "; ".join(f"{t.label} {t.error_px:.3f} px" for t in trials)
    why = (
        f"the simplest within {ENOUGH:.0%} of the best error" if lens == "auto" else "asked for by the parameter `lens`"
    )
    return chosen.model, f"{chosen.label}: {why} ({measured})"


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
