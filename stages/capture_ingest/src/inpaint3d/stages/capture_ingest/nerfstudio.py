"""nerfstudio and instant-ngp: transforms.json, OpenGL axes, intrinsics for all frames or for each."""

import json
import math
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.scene.image_io import read_header
from inpaint3d.stages.capture_ingest.axes import from_opengl
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, masks_for, numeric_order

FILE = "transforms.json"


def find(root: Path) -> Found:
    """Frames with their cameras. Frames that are listed but not there are left out, and noted."""
    try:
        document = json.loads((root / FILE).read_text())
        listed = document["frames"]
    except (ValueError, KeyError, TypeError) as error:
        raise BadInputError(f"{FILE} is not what nerfstudio writes ({error!r}); export it again") from error
    there = {_image(root, f["file_path"]): f for f in listed if _image(root, f["file_path"]) is not None}
    paths = sorted((p for p in there if p is not None), key=numeric_order)
    masks = masks_for(paths, root / "masks") if (root / "masks").is_dir() else {}
    frames = [FoundFrame(p.stem, p, masks.get(p.stem), _camera(p, {**document, **there[p]})) for p in paths]
    missing = len(listed) - len(frames)
    notes = [f"{FILE} lists {len(listed)} frames, {missing} of them are not there and left out"] if missing else []
    return Found("nerfstudio", frames, ordered=True, notes=notes)


def _image(root: Path, listed: str) -> Path | None:
    path = root / listed
    candidates = [path] if path.suffix else [path.with_suffix(s) for s in (".png", ".jpg", ".jpeg")]
    return next((p for p in candidates if p.is_file()), None)


def _camera(path: Path, values: dict[str, Any]) -> KnownCamera:
    """OPENCV where there is distortion, else PINHOLE; scaled where the picture is not of the size the file names."""
    width, height = read_header(path).upright_size
    try:
        scale_x, scale_y = width / values.get("w", width), height / values.get("h", height)
        fx = values["fl_x"] if "fl_x" in values else _focal(values["camera_angle_x"], values.get("w", width))
        fy = values.get("fl_y", fx)
        cx, cy = values.get("cx", width / scale_x / 2), values.get("cy", height / scale_y / 2)
        pose = from_opengl(values["transform_matrix"])
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise BadInputError(f"{FILE}: the camera of {path.name} is incomplete ({error!r}); export it again") from error
    if any(values.get(k) for k in ("k3", "k4")):
        raise BadInputError(f"{FILE}: {path.name} has k3 or k4; undistort the pictures, or estimate the cameras")
    pinhole = (fx * scale_x, fy * scale_y, cx * scale_x, cy * scale_y)
    distortion = tuple(float(values.get(k, 0.0)) for k in ("k1", "k2", "p1", "p2"))
    if any(distortion):
        return KnownCamera(model="OPENCV", params=(*pinhole, *distortion), world_from_cam=pose)
    return KnownCamera(model="PINHOLE", params=pinhole, world_from_cam=pose)


def _focal(angle: float, width: float) -> float:
    return 0.5 * width / math.tan(0.5 * angle)
