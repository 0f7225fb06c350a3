"""COLMAP's files: cameras and images, text or binary (src/colmap/scene/reconstruction_io.cc)."""

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.capture_ingest.lenses import PARAMETERS, UnreadModelError, check_model

# COLMAP's numbers (src/colmap/sensor/models.h).
MODEL_NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip
SUFFIXES = (".bin", ".txt")
POINT_BYTES = 24
IMAGE_FIELDS = 10


@dataclass(frozen=True)
class ListedCamera:
    """A lens; sizes in pixels, parameters in COLMAP's order for its model."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class ListedImage:
    """A registered picture: camera from world as quaternion (w, x, y, z) and translation."""

    number: int
    name: str
    camera: int
    quaternion: tuple[float, ...]
    translation: tuple[float, ...]


def has_model(folder: Path) -> bool:
    return any((folder / f"cameras{s}").is_file() and (folder / f"images{s}").is_file() for s in SUFFIXES)


def find_half(folder: Path) -> Path | None:
    """A file of a model whose other half is not there; None where there is a model, or nothing of one."""
    if has_model(folder):
        return None
    halves = (folder / f"{part}{s}" for part in ("cameras", "images") for s in SUFFIXES)
    return next((half for half in halves if half.is_file()), None)


def _is_binary(folder: Path) -> bool:
    return (folder / "cameras.bin").is_file() and (folder / "images.bin").is_file()


def count_images(folder: Path) -> int:
    """How many pictures a model holds; 0 where its file of images is damaged."""
    if _is_binary(folder):
        with (folder / "images.bin").open("rb") as file:
            head = file.read(8)
        return struct.unpack("<Q", head)[0] if len(head) == 8 else 0
    try:
        return len(_read_images_txt(folder / "images.txt"))
    except (ValueError, IndexError, OverflowError):
        return 0


def read_model(folder: Path, where: str) -> tuple[dict[int, ListedCamera], list[ListedImage]]:
    """Cameras by number, and images. `where`: the folder in the user's words.

    BadInputError names the file that is damaged, counts what it does not hold, or has a camera that is not read.
    """
    suffix, read_cameras, read_images = (
        (".bin", _read_cameras_bin, _read_images_bin)
        if _is_binary(folder)
        else (".txt", _read_cameras_txt, _read_images_txt)
    )
    file = "cameras"
    try:
        cameras = read_cameras(folder / f"cameras{suffix}")
        file = "images"
        images = read_images(folder / f"images{suffix}")
    except UnreadModelError as error:
        raise BadInputError(f"{where}/{file}{suffix}: a camera {error}") from error
    except (struct.error, ValueError, IndexError, KeyError, OverflowError, OSError) as error:
        raise BadInputError(f"{where}/{file}{suffix} is damaged ({error}); export the model again") from error
    return cameras, images


def _read_rows(path: Path) -> tuple[list[tuple[int, str]], int | None]:
    """Lines with their numbers, without comments, and how many entries the comments say that there are."""
    lines = list(enumerate(path.read_text(encoding="utf-8-sig").splitlines(), 1))
    said = next((m for _, line in lines if (m := re.match(r"#\s*Number of \w+:\s*(\d+)", line))), None)
    return [(n, line) for n, line in lines if not line.startswith("#")], int(said[1]) if said else None


def _check_count(found: int, said: int | None) -> None:
    if said is not None and found != said:
        raise ValueError(f"its header counts {said} entries, but it holds {found}")


def _read_cameras_txt(path: Path) -> dict[int, ListedCamera]:
    rows, said = _read_rows(path)
    listed = [line.split() for _, line in rows if line.strip()]
    for row in listed:
        check_model(row[1])
    cameras = {int(r[0]): ListedCamera(r[1], int(r[2]), int(r[3]), tuple(map(float, r[4:]))) for r in listed}
    _check_count(len(cameras), said)
    return cameras


def _read_images_txt(path: Path) -> list[ListedImage]:
    """Two lines an image: its pose and name, and its points, which may be an empty line that a tool left out."""
    rows, said = _read_rows(path)
    images: list[ListedImage] = []
    points_next = False
    for number, line in rows:
        if points_next and _is_points(line):
            points_next = False
        elif line.strip():
            images.append(_parse_image_txt(number, line))
            points_next = True
    _check_count(len(images), said)
    _check_unique(images)
    return images


def _is_points(line: str) -> bool:
    """x, y and a point's number, again and again; an image's line has ten fields, and a name at its end."""
    fields = line.split()
    return len(fields) % 3 == 0 and all(re.fullmatch(r"[-+.\deEinfa]+", field) for field in fields)


def _parse_image_txt(number: int, line: str) -> ListedImage:
    row = line.split(maxsplit=IMAGE_FIELDS - 1)
    if len(row) < IMAGE_FIELDS:
        raise ValueError(f"line {number} is neither a picture's pose and name nor its points: {line[:60]}")
    pose = tuple(map(float, row[1:8]))
    return ListedImage(int(row[0]), row[9].strip(), int(row[8]), pose[:4], pose[4:])


def _check_unique(images: list[ListedImage]) -> None:
    numbers = {image.number for image in images}
    if len(numbers) != len(images):
        raise ValueError(f"{len(images)} images have {len(numbers)} different numbers")


def _read_cameras_bin(path: Path) -> dict[int, ListedCamera]:
    cameras: dict[int, ListedCamera] = {}
    with path.open("rb") as file:
        (count,) = _unpack(file, "<Q")
        for _ in range(count):
            number, model, width, height = _unpack(file, "<iiQQ")
            name = MODEL_NAMES[model] if 0 <= model < len(MODEL_NAMES) else f"number {model}"
            check_model(name)
            cameras[number] = ListedCamera(name, width, height, _unpack(file, f"<{PARAMETERS[name]}d"))
        _check_end(file, path)
    _check_count(len(cameras), count)
    return cameras


def _read_images_bin(path: Path) -> list[ListedImage]:
    images: list[ListedImage] = []
    with path.open("rb") as file:
        (count,) = _unpack(file, "<Q")
        for _ in range(count):
            number, *pose, camera = _unpack(file, "<i7di")
            name = bytearray()
            while (byte := file.read(1)) not in (b"\0", b""):
                name += byte
            (points,) = _unpack(file, "<Q")
            file.seek(POINT_BYTES * points, 1)
            images.append(ListedImage(number, name.decode(), camera, tuple(pose[:4]), tuple(pose[4:])))
        _check_end(file, path)
    _check_unique(images)
    return images


def _check_end(file: BinaryIO, path: Path) -> None:
    """What lies beyond the last entry, or is missing of it, says that the counts are wrong."""
    if (at := file.tell()) != (size := path.stat().st_size):
        raise ValueError(f"it holds {size} bytes, but its entries end at {at}")


def _unpack(file: BinaryIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(layout, file.read(struct.calcsize(layout)))
