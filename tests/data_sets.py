"""Small data sets as their tools write them, of the synthetic room."""

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.synthetic import synthetic_scene

SCENE = synthetic_scene(views=4, width=32, height=24, points=20)
INTRINSICS = {"fl_x": SCENE.cameras[0].fx, "fl_y": SCENE.cameras[0].fy, "cx": 16.0, "cy": 12.0, "w": 32, "h": 24}


def write_pictures(root: Path, names: Sequence[str]) -> None:
    """Pictures of the views in turn, by their names with suffix."""
    for i, name in enumerate(names):
        write_png(root / name, SCENE.images[i % len(SCENE.images)])


def opengl_pose(camera: Camera) -> list[list[float]]:
    return (np.vstack([camera.world_from_cam, [0, 0, 0, 1]]) @ np.diag([1.0, -1, -1, 1])).tolist()


def nerfstudio_frames(names: Sequence[str]) -> list[dict[str, Any]]:
    return [{"file_path": name, "transform_matrix": opengl_pose(SCENE.cameras[i % 4])} for i, name in enumerate(names)]


def write_nerfstudio(root: Path, frames: list[dict[str, Any]], file: str = "transforms.json", **top: Any) -> None:
    root.mkdir(parents=True, exist_ok=True)
    (root / file).write_text(json.dumps({**INTRINSICS, **top, "frames": frames}))


def colmap_pose(camera: Camera) -> tuple[list[float], list[float]]:
    """Quaternion (w, x, y, z) and translation, camera from world."""
    r = camera.rotation.T
    w = np.sqrt(1 + np.trace(r)) / 2
    axis = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return [float(v) for v in (w, *(axis / (4 * w)))], [float(v) for v in -r @ camera.centre]


def write_colmap_text(
    folder: Path,
    names: Sequence[str],
    camera: str = f"SIMPLE_RADIAL 32 24 {SCENE.cameras[0].fx} 16 12 0.05",
    said: int | None = None,
    points: str | None = "",
) -> None:
    """A text model; `points` is each image's second line, None where a tool left it out."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(f"# Number of cameras: 1\n7 {camera}\n")
    rows = ["# Image list"] if said is None else [f"# Number of images: {said}, mean observations per image: 0"]
    for i, name in enumerate(names):
        q, t = colmap_pose(SCENE.cameras[i % 4])
        rows += [f"{i + 1} {' '.join(map(repr, [*q, *t]))} 7 {name}"]
        rows += [] if points is None else [points]
    (folder / "images.txt").write_text("\n".join(rows) + "\n")


def write_colmap_binary(folder: Path, names: Sequence[str], model: int = 2) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    parameters = (SCENE.cameras[0].fx, 16.0, 12.0, 0.05)
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 7, model, 32, 24, *parameters))
    body = struct.pack("<Q", len(names))
    for i, name in enumerate(names):
        q, t = colmap_pose(SCENE.cameras[i % 4])
        body += struct.pack("<i7di", i + 1, *q, *t, 7) + name.encode() + b"\0" + struct.pack("<Qddq", 1, 1.0, 2.0, -1)
    (folder / "images.bin").write_bytes(body)


def write_llff(root: Path, views: Sequence[int]) -> None:
    """poses_bounds.npy of the views, in that order."""
    rows = []
    for i in views:
        camera = SCENE.cameras[i]
        r, d, f = camera.world_from_cam[:, :3].T
        columns = [d, r, -f, camera.centre, [camera.height, camera.width, camera.fx]]
        rows.append([*np.stack(columns, 1).ravel(), 0.1, 10.0])
    np.save(root / "poses_bounds.npy", np.array(rows))
