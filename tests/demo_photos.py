"""Photos of the demo capture, made small, with the renderer's cameras in each data set's convention."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from inpaint3d.scene.cameras import Camera
from tests.conftest import REPOSITORY
from tests.data_sets import colmap_pose, opengl_pose

DEMO = REPOSITORY / "examples" / "demo"
RENDERER = json.loads((DEMO / "renderer" / "cameras.json").read_text())
POSES = {camera["name"]: np.array(camera["world_from_cam"]) for camera in RENDERER["images"]}
WIDTH, HEIGHT = RENDERER["width"], RENDERER["height"]


def names(step: int, count: int, first: int = 0) -> list[str]:
    return [f"frame_{i:03d}" for i in range(first, 50, step)][:count]


def photo(name: str, width: int) -> Image.Image:
    image = Image.open(DEMO / "capture" / "images" / f"{name}.jpg").convert("RGB")
    return image.resize((width, width * HEIGHT // WIDTH), Image.Resampling.BOX)


def write_photos(folder: Path, photos: dict[str, str], width: int, **options: Any) -> None:
    """`photos`: file below the folder -> the demo's photo."""
    for file, name in photos.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        photo(name, width).save(folder / file, **{"quality": 90, **options})


def object_mask(name: str, width: int) -> np.ndarray:
    """Where the demo's object is, bool [h, w]."""
    mask = Image.open(DEMO / "renderer" / "masks" / f"{name}.png").convert("L")
    return np.asarray(mask.resize((width, width * HEIGHT // WIDTH), Image.Resampling.NEAREST)) > 127


def lens(width: int) -> tuple[float, ...]:
    """SIMPLE_RADIAL: focal length, centre, k1."""
    f, cx, cy, k = RENDERER["params"]
    scale = width / WIDTH
    return f * scale, cx * scale, cy * scale, k


def camera(name: str, width: int) -> Camera:
    f, cx, cy, _ = lens(width)
    return Camera(f, f, cx, cy, width, width * HEIGHT // WIDTH, POSES[name])


def write_transforms(root: Path, photos: dict[str, str], width: int, **top: Any) -> list[dict[str, Any]]:
    """transforms.json of pictures with the renderer's lens; its frames."""
    f, cx, cy, k = lens(width)
    known = {"fl_x": f, "fl_y": f, "cx": cx, "cy": cy, "w": width, "h": width * HEIGHT // WIDTH, "k1": k}
    frames = [
        {"file_path": file, "transform_matrix": opengl_pose(camera(name, width))} for file, name in photos.items()
    ]
    write_json(root / "transforms.json", {**known, **top, "frames": frames})
    return frames


def write_json(path: Path, document: dict[str, Any]) -> None:
    path.write_text(json.dumps(document))


def write_model(folder: Path, photos: dict[str, str], width: int) -> None:
    """COLMAP's text model of pictures."""
    folder.mkdir(parents=True)
    size = f"{width} {width * HEIGHT // WIDTH}"
    (folder / "cameras.txt").write_text(f"1 SIMPLE_RADIAL {size} {' '.join(map(str, lens(width)))}\n")
    rows: list[str] = []
    for i, (file, name) in enumerate(photos.items(), 1):
        q, t = colmap_pose(camera(name, width))
        rows += [f"{i} {' '.join(map(str, [*q, *t]))} 1 {file}", ""]
    (folder / "images.txt").write_text("\n".join(rows) + "\n")


def llff_row(name: str, width: int) -> np.ndarray:
    """17 numbers: axes down, right, backwards, the centre, (height, width, focal length), near, far."""
    right, down, forward, centre = POSES[name].T
    columns = [down, right, -forward, centre, [width * HEIGHT // WIDTH, width, lens(width)[0]]]
    return np.array([*np.stack(columns, 1).ravel(), 0.1, 20.0])
