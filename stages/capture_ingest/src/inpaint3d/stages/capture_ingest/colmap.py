"""A COLMAP model beside its pictures: `sparse/0/` or `sparse/`, text or binary."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, get_args

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.image_io import read_header
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, masks_for, numeric_order

# COLMAP's number of each model, and how many parameters it has (src/colmap/sensor/models.h).
MODELS = {0: ("SIMPLE_PINHOLE", 3), 1: ("PINHOLE", 4), 2: ("SIMPLE_RADIAL", 4), 3: ("RADIAL", 5), 4: ("OPENCV", 8)}
SUPPORTED = get_args(KnownCamera.model_fields["model"].annotation)
Cameras = dict[int, tuple[str, int, tuple[float, ...]]]
Image = tuple[str, int, tuple[float, ...], tuple[float, ...]]


def model_folder(root: Path) -> Path | None:
    """Where the model lies, or None."""
    for folder in (root / "sparse" / "0", root / "sparse", root):
        if any((folder / f"cameras{s}").is_file() and (folder / f"images{s}").is_file() for s in (".bin", ".txt")):
            return folder
    return None


def find(root: Path) -> Found:
    """The registered pictures with their cameras; BadInputError for a broken model or a missing picture."""
    folder = model_folder(root)
    if folder is None:
        raise BadInputError(f"no cameras.bin or cameras.txt below {root.name}/sparse; export the model there")
    binary = (folder / "cameras.bin").is_file()
    try:
        cameras = _cameras_bin(folder) if binary else _cameras_txt(folder)
        images = list(_images_bin(folder) if binary else _images_txt(folder))
    except (struct.error, ValueError, IndexError, KeyError, UnicodeDecodeError) as error:
        raise BadInputError(f"the model in {folder.name}/ is damaged ({error!r}); export it again") from error
    paths = {name: _picture(root, name) for name, *_ in images}
    masks = masks_for(list(paths.values()), root / "masks") if (root / "masks").is_dir() else {}
    frames = [
        FoundFrame(
            paths[name].stem, paths[name], masks.get(paths[name].stem), _known(paths[name], cameras[camera], q, t)
        )
        for name, camera, q, t in images
    ]
    return Found("colmap", sorted(frames, key=lambda f: numeric_order(f.image)))


def _picture(root: Path, name: str) -> Path:
    for path in (root / "images" / name, root / name):
        if path.is_file():
            return path
    raise BadInputError(f"the model names {name}, which is not in images/; put the pictures there")


def _known(path: Path, camera: tuple[str, int, tuple[float, ...]], q: tuple[float, ...], t: tuple[float, ...]):
    model, model_width, params = camera
    if model not in SUPPORTED:
        raise BadInputError(f"{path.name}: camera model {model}; undistort with COLMAP first, or estimate the cameras")
    scale = read_header(path).upright_size[0] / model_width
    lengths = 3 if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else 4
    scaled = tuple(p * scale if i < lengths else p for i, p in enumerate(params))
    rotation = quaternion_matrix(q)  # camera from world
    centre = -rotation.T @ np.array(t)
    pose = as_pose(np.concatenate([rotation.T, centre[:, None]], 1))
    return KnownCamera(model=model, params=scaled, world_from_cam=pose)  # pyright: ignore[reportArgumentType]


def quaternion_matrix(q: tuple[float, ...]) -> np.ndarray:
    """Rotation [3, 3] of a quaternion (w, x, y, z)."""
    w, x, y, z = np.array(q) / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _lines(path: Path) -> list[str]:
    return [line for line in path.read_text().splitlines() if not line.startswith("#")]


def _cameras_txt(folder: Path) -> Cameras:
    rows = [line.split() for line in _lines(folder / "cameras.txt") if line.strip()]
    return {int(r[0]): (r[1], int(r[2]), tuple(map(float, r[4:]))) for r in rows}


def _images_txt(folder: Path) -> Iterator[Image]:
    # Two lines an image: its pose and name, and its points, which may be an empty line.
    for line in _lines(folder / "images.txt")[::2]:
        row = line.split(maxsplit=9)
        if len(row) == 10:
            yield row[9], int(row[8]), tuple(map(float, row[1:5])), tuple(map(float, row[5:8]))


def _cameras_bin(folder: Path) -> Cameras:
    found: Cameras = {}
    with (folder / "cameras.bin").open("rb") as file:
        (count,) = _read(file, "<Q")
        for _ in range(count):
            number, model, width, _height = _read(file, "<iiQQ")
            name, parameters = MODELS.get(model, (f"number {model}", 0))
            if not parameters:
                raise BadInputError(f"cameras.bin: camera model {name}; undistort with COLMAP first")
            found[number] = (name, width, _read(file, f"<{parameters}d"))
    return found


def _images_bin(folder: Path) -> Iterator[Image]:
    with (folder / "images.bin").open("rb") as file:
        (count,) = _read(file, "<Q")
        for _ in range(count):
            _, *pose, camera = _read(file, "<i7di")
            name = bytearray()
            while (byte := file.read(1)) not in (b"\0", b""):
                name += byte
            (points,) = _read(file, "<Q")
            file.seek(24 * points, 1)
            yield name.decode(), camera, tuple(pose[:4]), tuple(pose[4:])


def _read(file: BinaryIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(layout, file.read(struct.calcsize(layout)))
