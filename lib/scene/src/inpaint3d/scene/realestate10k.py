"""RealEstate10k on disk: camera files and frames (Zhou et al., Stereo Magnification, arXiv:1805.09817).

    ANY/CLIP.txt              the video's address, then a row for each frame: timestamp, fx fy cx cy, 0 0, and
                              cam_from_world [3, 4] by rows; intrinsics as shares of the picture's width and height
    ANY/CLIP/TIMESTAMP.jpg    frames that somebody cut out of the videos; those that are not there are left out

A clip's camera file below a folder `train` or `test` belongs to that split, as in the published archive.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES

COLUMNS = 19


@dataclass(frozen=True, eq=False)
class ClipFrame:
    """A frame that is there. intrinsics: fx, fy, cx, cy as shares of width, height, width, height."""

    image: Path
    intrinsics: tuple[float, float, float, float]
    world_from_cam: NDArray[np.float64]
    """[3, 4], OpenCV axes (x right, y down, z forward)."""


@dataclass(frozen=True, eq=False)
class Clip:
    """Neighbouring frames of one video, in the order they were taken."""

    name: str
    video: str
    """Address of the video: clips of one video show one scene."""
    split: Literal["train", "test"] | None
    frames: tuple[ClipFrame, ...]


def camera_files(root: Path) -> Iterator[Path]:
    """The text files below `root` that begin with a video's address, by name."""
    for path in sorted(root.rglob("*.txt")):
        with path.open("rb") as file:
            if file.readline(256).startswith((b"https://", b"http://")):
                yield path


def read_clips(root: Path) -> list[Clip]:
    """Every clip below `root` with the frames that are there; clips without any are left out.

    Raises BadInputError for a row that is not a camera, naming file and line.
    """
    folders = {path.name: path for path in sorted(root.rglob("*")) if path.is_dir()}
    clips = [_read_clip(path, folders.get(path.stem), root) for path in camera_files(root)]
    return [clip for clip in clips if clip.frames]


def _read_clip(path: Path, folder: Path | None, root: Path) -> Clip:
    pictures = {p.stem: p for p in folder.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES} if folder else {}
    video, *rows = path.read_text().splitlines()
    frames: list[ClipFrame] = []
    for number, row in enumerate(rows, start=2):
        if not row.strip():
            continue
        timestamp, values = _read_numbers(row, f"{path.relative_to(root)}, line {number}")
        if timestamp in pictures:
            cam_from_world = values[6:].reshape(3, 4)
            rotation = cam_from_world[:, :3].T
            world_from_cam = np.concatenate([rotation, -rotation @ cam_from_world[:, 3:]], 1)
            fx, fy, cx, cy = (float(v) for v in values[:4])
            frames.append(ClipFrame(pictures[timestamp], (fx, fy, cx, cy), world_from_cam))
    splits = [part for part in path.relative_to(root).parts[:-1] if part in ("train", "test")]
    split: Literal["train", "test"] | None = None if not splits else "train" if splits[-1] == "train" else "test"
    return Clip(path.stem, video.strip(), split, tuple(frames))


def _read_numbers(row: str, where: str) -> tuple[str, NDArray[np.float64]]:
    timestamp, *rest = row.split()
    try:
        values = np.array([float(v) for v in rest])
    except ValueError as error:
        raise BadInputError(f"{where}: {error}; get the camera file again") from error
    if len(values) != COLUMNS - 1 or not np.isfinite(values).all():
        raise BadInputError(
            f"{where}: {len(values) + 1} columns, {int((~np.isfinite(values)).sum())} of them not finite; a camera has "
            f"{COLUMNS}: get the camera file again"
        )
    return timestamp, values
