"""Truth views against the fixed model: their poses alone are found; they triangulate nothing and move nothing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import CapturedFrame
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.features import add_pictures, create_database, features_of, match, number_of
from inpaint3d.stages.pose_estimation.model import Model, round_pose

Floats = NDArray[np.float64]

MIN_INLIERS = 12
LARGEST_ERROR_SHARE = 0.008  # of the longest side, for a match to count


@dataclass(frozen=True)
class Registered:
    """A truth view's pose [3, 4] in the model's world, its lens, and its mean reprojection error (captured px)."""

    world_from_cam: Floats
    lens: int
    error_px: float


def lens_for(frame: CapturedFrame, model: Model) -> int:
    """The number of the capture's lens that took a truth frame: of its size and, as far as EXIF says, focal length."""
    fitting = [n for n in set(model.view_lens) if _get_size(model.lenses[n]) == (frame.width, frame.height)]
    if fitting and (focal := frame.exif.focal_px):
        return min(fitting, key=lambda n: (abs(np.log(focal / model.lenses[n].mean_focal_length())), n))
    if fitting:
        return max(fitting, key=lambda n: (model.view_lens.count(n), -n))
    sizes = sorted({f"{c.width}x{c.height}" for c in model.lenses.values()})
    raise BadInputError(
        f"truth view {frame.name} is {frame.width}x{frame.height} but the capture's frames are {', '.join(sizes)}; "
        "give truth views as the same camera took them"
    )


def _get_size(lens: pycolmap.Camera) -> tuple[int, int]:
    return lens.width, lens.height


def register(
    frames: Sequence[CapturedFrame],
    paths: dict[str, str],
    model: Model,
    database: Path,
    folder: Path,
    config: Config,
    ctx: Context,
) -> dict[str, Registered]:
    """Poses of the truth views that can be placed, by name. `paths`: frame name -> path below `folder`."""
    groups: dict[int, list[str]] = {}
    for frame in frames:
        groups.setdefault(lens_for(frame, model), []).append(paths[frame.name])
    own = database.with_name("truth.db")
    create_database(own, [], copy_of=database)
    add_pictures(own, folder, groups, config, ctx)
    step = max(1, -(-len(model.names) // config.truth_partners))
    partners = model.names[::step]
    match(own, [(paths[f.name], partner) for f in frames for partner in partners], ctx)
    points_of = _index_points(model, database)
    placed: dict[str, Registered] = {}
    with pycolmap.Database.open(own) as db:
        for frame in frames:
            xy, xyz = _find_correspondences(db, paths[frame.name], partners, points_of, model)
            found = _pose(xy, xyz, model.lenses[lens_for(frame, model)], ctx.seed)
            if found is not None:
                placed[frame.name] = Registered(found[0], lens_for(frame, model), found[1])
    return placed


def _index_points(model: Model, database: Path) -> dict[str, NDArray[np.int64]]:
    """For each view, the point of each of its features, or -1; features are known by where they are."""
    found: dict[str, NDArray[np.int64]] = {}
    points = model.track_point
    with pycolmap.Database.open(database) as db:
        for view, name in enumerate(model.names):
            xy = features_of(db, name)
            rows = np.flatnonzero(model.track_view == view)
            where = {
                tuple(p): point for p, point in zip(model.track_xy[rows].tolist(), points[rows].tolist(), strict=True)
            }
            found[name] = np.array([where.get(tuple(p), -1) for p in xy.tolist()], np.int64)
    return found


def _find_correspondences(
    db: pycolmap.Database, path: str, partners: Sequence[str], points_of: dict[str, NDArray[np.int64]], model: Model
) -> tuple[Floats, Floats]:
    """Pixels [k, 2] of a truth view and the points [k, 3] that verified matches tie them to, each pair once."""
    number, features = number_of(db, path), features_of(db, path)
    pairs: set[tuple[int, int]] = set()
    for partner in partners:
        other = number_of(db, partner)
        if not db.exists_two_view_geometry(number, other):
            continue
        for mine, theirs in db.read_two_view_geometry(number, other).inlier_matches.tolist():
            if (point := int(points_of[partner][theirs])) >= 0:
                pairs.add((mine, point))
    chosen = np.array(sorted(pairs), np.int64).reshape(-1, 2)
    return features[chosen[:, 0]], model.xyz[chosen[:, 1]]


def _pose(xy: Floats, xyz: Floats, lens: pycolmap.Camera, seed: int) -> tuple[Floats, float] | None:
    """Pose [3, 4] by RANSAC and refinement of the pose alone, and its mean error; None with too little evidence."""
    if len(xy) < MIN_INLIERS:
        return None
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = LARGEST_ERROR_SHARE * max(lens.width, lens.height)
    options.ransac.random_seed = seed
    found = pycolmap.estimate_and_refine_absolute_pose(xy, xyz, lens, options)
    if found is None or found["num_inliers"] < MIN_INLIERS:
        return None
    inliers = np.asarray(found["inlier_mask"], bool)
    pose = round_pose(found["cam_from_world"].inverse().matrix())
    in_cam = (xyz[inliers] - pose[:, 3]) @ pose[:, :3]
    error = np.linalg.norm(np.asarray(lens.img_from_cam(np.ascontiguousarray(in_cam))) - xy[inliers], axis=1)
    return pose, float(error.mean())
