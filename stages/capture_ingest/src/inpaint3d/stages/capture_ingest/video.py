"""A video: the sharpest frame of each of as many stretches, over each of which the picture moves as much."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame

EVEN_SIDE = 320  # sharpness is compared on a small copy: noise of a large one would win
STILL = 0.002  # mean change of grey, in [0, 1], below which a frame shows nothing new: sensor noise, compression
WHITE = 203  # cd/m2; what FFmpeg's scaler, in OpenCV's reader, makes white (ITU-R BT.2408)
JUMP = 5.0  # median changes; a cut or a flash counts no more than this

Bytes = NDArray[np.uint8]


def find(path: Path, count: int, folder: Path) -> Found:
    """Choose at most `count` frames and write them below `folder`; BadInputError where the video cannot be decoded."""
    sharpness, change, bits = _look_through(path)
    if len(sharpness) < 2:
        raise BadInputError(
            f"{path.name} has {len(sharpness)} frames that can be decoded; give a video of a walk around"
        )
    chosen = choose_frames(sharpness, change, count)
    frames: list[FoundFrame] = []
    for index, picture in _read_chosen(path, chosen):
        target = folder / f"frame_{index:06d}.png"
        write_png(target, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
        frames.append(FoundFrame(target.stem, target))
    resting = int(np.sum(change[1:] < STILL))
    notes = [
        f"{len(frames)} of {len(sharpness)} frames: the sharpest of stretches over which the picture changes as much; "
        f"{resting} change nothing"
    ]
    if bits > 8:
        notes.append(
            f"{bits} bits a channel: where {path.name} says that it is HDR (PQ, HLG), light of {WHITE} cd/m2 becomes "
            "white and brighter light is clipped; where it says nothing, its codes are taken as SDR"
        )
    return Found("video", frames, ordered=True, notes=notes)


def choose_frames(sharpness: NDArray[np.float64], change: NDArray[np.float64], count: int) -> list[int]:
    """Numbers of the sharpest frames [at most count] of stretches of equal change, in order.

    `change` [n] is how much each frame differs from the one before. Where the camera rests nothing is taken twice,
    whatever the frame rate; where nothing moves at all, stretches are of equal length.
    """
    moved = np.where(change < STILL, 0.0, change)
    moved = np.minimum(moved, JUMP * np.median(moved[moved > 0])) if moved.any() else np.ones_like(change)
    way = np.cumsum(moved)
    stretch = np.minimum((count * (way - way[0]) / max(way[-1] - way[0], 1e-12)).astype(np.int64), count - 1)
    order = np.lexsort((-sharpness, stretch))  # by stretch, the sharpest first
    first = np.unique(stretch[order], return_index=True)[1]
    return order[first].tolist()


def _look_through(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    """Of every frame, the variance of its Laplacian, and its mean absolute difference from the one before (grey).

    And the bits of a channel.
    """
    sharpness: list[float] = []
    change: list[float] = []
    before: Bytes | None = None
    reader = cv2.VideoCapture(str(path))
    while (picture := _read_next(reader)) is not None:
        grey = _shrink(picture)
        sharpness.append(float(cv2.Laplacian(grey, cv2.CV_32F).var()))
        change.append(0.0 if before is None else float(cv2.norm(grey, before, cv2.NORM_L1)) / grey.size / 255)
        before = grey
    bits = _read_bits(reader)
    reader.release()
    return np.array(sharpness), np.array(change), bits


def _read_bits(reader: cv2.VideoCapture) -> int:
    """Bits of a channel; FFmpeg tags planar formats of more than 8 bits "Y3", a number for the layout, the bits."""
    tag = int(reader.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)).to_bytes(8, "little", signed=True)[:4]
    return tag[3] if tag.startswith(b"Y3") and 8 < tag[3] <= 16 else 8


def _shrink(picture: Bytes) -> Bytes:
    scale = EVEN_SIDE / max(picture.shape)
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else picture
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_BGR2GRAY), np.uint8)


def _read_next(reader: cv2.VideoCapture) -> Bytes | None:
    good, picture = reader.read()
    return np.asarray(picture, np.uint8) if good else None


def _read_chosen(path: Path, chosen: list[int]) -> Iterator[tuple[int, Bytes]]:
    """The chosen frames; those between are passed over undecoded as far as the codec lets."""
    reader, wanted = cv2.VideoCapture(str(path)), set(chosen)
    for index in range(max(chosen) + 1):
        if not reader.grab():
            break
        if index in wanted:
            good, picture = reader.retrieve()
            if good:
                yield index, np.asarray(picture, np.uint8)
    reader.release()
