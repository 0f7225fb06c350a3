"""LLFF: poses_bounds.npy, a row of 17 numbers for each picture: 3x5 pose with [height, width, focal], near, far."""

import tokenize
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.contracts.models.base import Pose
from inpaint3d.scene.image_io import read_header
from inpaint3d.stages.capture_ingest.axes import from_llff
from inpaint3d.stages.capture_ingest.found import (
    Found,
    FoundFrame,
    find_subfolder,
    masks_for,
    name_pictures,
    picture_folder,
    pictures_in,
)
from inpaint3d.stages.capture_ingest.lenses import StatedLens, fit_camera, stated_frame

FILE = "poses_bounds.npy"


class RowCamera(NamedTuple):
    """A picture's camera by the rows in the order of names as text; its pose if they follow the names as numbers."""

    camera: KnownCamera
    other_pose: Pose | None = None


def read_cameras(root: Path, pictures: list[Path]) -> dict[Path, RowCamera]:
    """Picture -> its camera. The rows have no names: LLFF's imgs2poses.py writes them in the order of names as text.

    Other tools write f_2 before f_10: where that is another order, each camera has its pose under that one too, and
    pose-estimation takes the order that the pictures support.
    """
    rows = _read_rows(root / FILE)
    if len(rows) != len(pictures):
        raise BadInputError(
            f"{FILE} has {len(rows)} cameras for {len(pictures)} pictures; put as many into images/, not below it"
        )
    as_text = sorted(pictures, key=lambda p: p.name)
    cameras = {path: _make_camera(row, path) for row, path in zip(rows, as_text, strict=True)}
    if as_text == pictures or any(c.params != cameras[as_text[0]].params for c in cameras.values()):
        return {path: RowCamera(camera) for path, camera in cameras.items()}
    others = {path: _make_camera(row, path).world_from_cam for row, path in zip(rows, pictures, strict=True)}
    return {path: RowCamera(camera, others[path]) for path, camera in cameras.items()}


def describe_order(pictures: list[Path], cameras: dict[Path, RowCamera]) -> list[str]:
    """A note where the rows' order is not the one in which a person counts."""
    as_text = sorted(pictures, key=lambda p: p.name)
    if as_text == pictures:
        return []
    first, other = next((a.name, b.name) for a, b in zip(as_text, pictures, strict=True) if a != b)
    order = f"in the order of names as text, {first} before {other}"
    if cameras[pictures[0]].other_pose is None:
        return [f"the rows of {FILE} are taken {order}"]
    return [
        f"the rows of {FILE} have no names: {order}, or as numbers: pose-estimation takes what the pictures support"
    ]


def _read_rows(path: Path) -> np.ndarray:
    try:
        # Mapped, a header that claims more than the file holds is refused; read, it would be allocated.
        with warnings.catch_warnings(action="ignore"):  # headers that Python 2 wrote
            rows = np.load(path, allow_pickle=False, mmap_mode="r")
        if not isinstance(rows, np.ndarray) or rows.dtype.kind not in "fiu":
            raise ValueError("no array of numbers")
        if rows.ndim != 2 or rows.shape[1] != 17:
            raise ValueError(f"{list(rows.shape)}, not [pictures, 17]")
        return np.array(rows, np.float64)
    except (ValueError, OSError, EOFError, OverflowError, TypeError, SyntaxError, tokenize.TokenError) as error:
        raise BadInputError(f"{FILE} cannot be read ({error}); export it again") from error


def _make_camera(row: np.ndarray, path: Path) -> KnownCamera:
    pose = row[:15].reshape(3, 5)
    pose_height, pose_width, focal = (float(v) for v in pose[:, 4])
    if not (np.isfinite([pose_height, pose_width, focal]).all() and min(pose_height, pose_width, focal) > 0):
        raise BadInputError(
            f"{FILE}: the row of {path.name} has height, width and focal length {pose_height:g}, {pose_width:g}, "
            f"{focal:g}; export it again"
        )
    try:
        (width, height), _ = stated_frame(read_header(path), (pose_width, pose_height))
    except ValueError as error:
        raise BadInputError(f"{FILE}: the row of {path.name} {error}; export it again") from error
    scaled = focal * width / pose_width
    lens = StatedLens("PINHOLE", (scaled, scaled, width / 2, height / 2), (width, height))
    return fit_camera(path, lens, from_llff(pose[:, :4]), FILE)


def find(root: Path) -> Found:
    """Frames of `images/` with the cameras of the file, and masks where there are any."""
    pictures = pictures_in(picture_folder(root))
    cameras = read_cameras(root, pictures)
    names = name_pictures(pictures)
    masks = masks_for(pictures, find_subfolder(root, "masks"))
    frames = [FoundFrame(names[p], p, masks.get(p), *cameras[p]) for p in pictures]
    return Found("llff", frames, notes=describe_order(pictures, cameras))
