"""What would make cameras that contradict their pictures agree with them: the usual slips, tried on the matches."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from inpaint3d.stages.pose_estimation.agreement import Cameras, Floats, measure_agreement
from inpaint3d.stages.pose_estimation.matches import VerifiedPair

GAIN = 1.4
MATCHES = 50  # of each pair, evenly chosen
OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
FOCAL_FACTORS = (0.5, 0.6, 0.7, 0.77, 0.85, 0.92, 1.08, 1.18, 1.3, 1.43, 1.65, 2.0)


@dataclass(frozen=True)
class Repair:
    """A change of the cameras, in words, and how far matches usually are off after it (share of the longest side)."""

    words: str
    median_distance: float


def find_repair(pairs: Sequence[VerifiedPair], cameras: Cameras, tolerance: float) -> Repair | None:
    """The change under which matches lie nearest to where the cameras say.

    None where none brings most of them within `tolerance` and clearly nearer than they are.
    """
    thinned = [_thin(pair) for pair in pairs]
    if not thinned:
        return None
    given = measure_agreement(thinned, cameras, 0.0).median_distance
    tried = [Repair(words, measure_agreement(thinned, c, 0.0).median_distance) for words, c in _list_changes(cameras)]
    best = min(tried, key=lambda repair: repair.median_distance)
    better = GAIN * best.median_distance < given and best.median_distance <= tolerance
    return best if better else None


def _thin(pair: VerifiedPair) -> VerifiedPair:
    rows = np.unique(np.linspace(0, len(pair) - 1, MATCHES).round().astype(np.int64))
    return replace(pair, first_xy=pair.first_xy[rows], second_xy=pair.second_xy[rows])


def _list_changes(cameras: Cameras) -> Iterator[tuple[str, Cameras]]:
    poses = cameras.world_from_cam
    yield (
        "if the cameras have OpenGL's axes (y up, z backwards), not OpenCV's",
        replace(cameras, world_from_cam=[_pose(p[:, :3] @ OPENCV_FROM_OPENGL, p[:, 3]) for p in poses]),
    )
    yield (
        "if the poses are the wrong way round (camera from world)",
        replace(cameras, world_from_cam=[_pose(p[:, :3].T, -p[:, :3].T @ p[:, 3]) for p in poses]),
    )
    yield "if they are in the reverse order", replace(cameras, world_from_cam=poses[::-1], lenses=cameras.lenses[::-1])
    for factor in FOCAL_FACTORS:
        lenses = [_scale_focal(lens, factor) for lens in cameras.lenses]
        yield f"if focal lengths are {factor:g} times as long", replace(cameras, lenses=lenses)


def _pose(rotation: Floats, centre: Floats) -> Floats:
    return np.concatenate([rotation, centre[:, None]], 1)


def _scale_focal(lens: pycolmap.Camera, factor: float) -> pycolmap.Camera:
    scaled = pycolmap.Camera(lens.todict())
    params = np.array(scaled.params)
    params[list(scaled.focal_length_idxs())] *= factor
    scaled.params = params.tolist()
    return scaled
