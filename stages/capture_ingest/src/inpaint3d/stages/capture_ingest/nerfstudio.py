"""nerfstudio and instant-ngp: transforms.json, OpenGL axes, intrinsics for all frames or for each.

NeRF's synthetic scenes (`blender.py`) have the same kind of file for each of their splits.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.contracts.models.untrusted import MAX_JSON_BYTES, parse_json, read_bounded
from inpaint3d.scene.image_io import read_header
from inpaint3d.stages.capture_ingest.axes import from_opengl
from inpaint3d.stages.capture_ingest.found import (
    Found,
    FoundFrame,
    SourceFiles,
    find_subfolder,
    masks_for,
    name_pictures,
    numeric_order,
    one_folder,
)
from inpaint3d.stages.capture_ingest.lenses import StatedLens, check_model, fit_camera

FILE = "transforms.json"


def find(root: Path) -> Found:
    """Frames with their cameras and masks. Frames that are listed but not there are left out, and noted."""
    files = SourceFiles(root)
    frames, notes = read_frames(files, FILE)
    return Found("nerfstudio", frames, ordered=one_folder(frames), notes=notes + files.notes(FILE))


def read_frames(files: SourceFiles, document: str) -> tuple[list[FoundFrame], list[str]]:
    """The frames of one file in numeric order, and what is to be said of it."""
    top, listed = _read(files.root / document)
    places = [(frame, files.find(frame.get("file_path"), document)) for frame in listed]
    there: dict[Path, dict[str, Any]] = {}
    for frame, path in places:
        if path is not None and there.setdefault(path, frame) is not frame:
            raise BadInputError(f"{document} lists {frame['file_path']} twice; list it once")
    paths = sorted(there, key=numeric_order)
    names = name_pictures(paths)
    named = any("mask_path" in frame for frame in listed)
    masks = {} if named else masks_for(paths, find_subfolder(files.root, "masks"))
    frames: list[FoundFrame] = []
    for path in paths:
        values = {**top, **there[path]}
        mask = _mask(files, values, document)
        camera = read_camera(path, values, document)
        frames.append(FoundFrame(names[path], path, mask or masks.get(path), camera, hole_is_black=mask is not None))
    return frames, _make_notes(document, listed, len(frames))


def _make_notes(document: str, listed: list[dict[str, Any]], taken: int) -> list[str]:
    notes: list[str] = []
    if missing := len(listed) - taken:
        notes.append(f"{document} lists {len(listed)} frames, {missing} of them are not there and left out")
    if depths := sum("depth_file_path" in frame for frame in listed):
        notes.append(f"{document} names {depths} depth pictures (depth_file_path), which are not read")
    return notes


def _read(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    try:
        top = parse_json(read_bounded(path, MAX_JSON_BYTES))
        listed = top["frames"]
        if not isinstance(listed, list) or not all(isinstance(frame, dict) for frame in listed):
            raise TypeError("frames is no list of objects")
    except (ValueError, KeyError, TypeError) as error:
        raise BadInputError(f"{path.name} is not what nerfstudio writes ({error!r}); export it again") from error
    return {key: value for key, value in top.items() if key != "frames"}, listed


def _mask(files: SourceFiles, values: dict[str, Any], document: str) -> Path | None:
    if (listed := values.get("mask_path")) is None:
        return None
    if (path := files.find(listed, document)) is None:
        raise BadInputError(f"{document}: mask_path {listed} is not there; put the mask there, or remove the entry")
    return path


def read_camera(path: Path, values: dict[str, Any], document: str) -> KnownCamera:
    """A fisheye, OPENCV where there is distortion, else PINHOLE; BadInputError names the document and the picture."""
    try:
        model = _name_model(values)
        check_model(model)
    except ValueError as error:
        raise BadInputError(f"{document}: the camera of {path.name} {error}") from error
    header = read_header(path)
    size = (header.width, header.height)
    try:
        size = (_read_number(values, "w", size[0]), _read_number(values, "h", size[1]))
        fx = (
            _read_number(values, "fl_x")
            if "fl_x" in values
            else _compute_focal(_read_number(values, "camera_angle_x"), size[0])
        )
        fy = _read_number(values, "fl_y") if "fl_y" in values else _find_vertical_focal(values, fx, size[1])
        pinhole = (fx, fy, _read_number(values, "cx", size[0] / 2), _read_number(values, "cy", size[1] / 2))
        k1, k2, k3, k4, p1, p2 = (_read_number(values, k, 0.0) for k in ("k1", "k2", "k3", "k4", "p1", "p2"))
        pose = from_opengl(_check_last_row(values["transform_matrix"]))
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, ZeroDivisionError) as error:
        raise BadInputError(
            f"{document}: the camera of {path.name} is incomplete ({error!r}); export it again"
        ) from error
    if model == "OPENCV_FISHEYE":
        return fit_camera(path, StatedLens(model, (*pinhole, k1, k2, k3, k4), size), pose, document)
    if k3 or k4:
        raise BadInputError(f"{document}: {path.name} has k3 or k4; undistort the pictures, or estimate the cameras")
    bends = any((k1, k2, p1, p2))
    lens = StatedLens("OPENCV", (*pinhole, k1, k2, p1, p2), size) if bends else StatedLens("PINHOLE", pinhole, size)
    return fit_camera(path, lens, pose, document)


def _name_model(values: dict[str, Any]) -> str:
    """The model's name in COLMAP's words; instant-ngp says by flags what is no perspective."""
    if values.get("ftheta_p0"):
        return "FTHETA (ftheta_p0)"
    if (fisheye := values.get("is_fisheye", False)) not in (True, False):
        raise ValueError(f"has is_fisheye {fisheye!r}; it must be true or false")
    if fisheye:
        return "OPENCV_FISHEYE"
    return str(values.get("camera_model") or "OPENCV").upper()


def _read_number(values: dict[str, Any], key: str, default: float | None = None) -> float:
    value = values[key] if default is None else values.get(key, default)
    if isinstance(value, bool):
        raise TypeError(f"{key} is {value}, no number")
    return float(value)


def _check_last_row(matrix: Any) -> Any:
    """ValueError for a homogeneous matrix that would scale or project."""
    if len(matrix) == 4 and not np.allclose(matrix[3], (0, 0, 0, 1), rtol=0):
        raise ValueError(f"the last row of its pose is {matrix[3]}; it must be 0, 0, 0, 1")
    return matrix


def _compute_focal(angle: float, size: float) -> float:
    return 0.5 * size / math.tan(0.5 * angle)


def _find_vertical_focal(values: dict[str, Any], fx: float, height: float) -> float:
    """By its own angle where there is one and no focal length at all, else as the horizontal one."""
    if "fl_x" not in values and "camera_angle_y" in values:
        return _compute_focal(_read_number(values, "camera_angle_y"), height)
    return fx
