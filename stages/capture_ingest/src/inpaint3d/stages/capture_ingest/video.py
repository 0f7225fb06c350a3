"""A video: the sharpest frame of each of evenly spaced stretches."""

import itertools
from pathlib import Path

import cv2

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame

EVEN_SIDE = 320  # sharpness is compared on a small copy: noise of a large one would win


def find(path: Path, count: int, folder: Path) -> Found:
    """Choose `count` frames and write them below `folder`; BadInputError where the video cannot be decoded."""
    sharpness = _sharpness(path)
    if len(sharpness) < 2:
        raise BadInputError(
            f"{path.name} has {len(sharpness)} frames that can be decoded; give a video of a walk around"
        )
    edges = [round(i * len(sharpness) / min(count, len(sharpness))) for i in range(min(count, len(sharpness)) + 1)]
    chosen = {max(range(a, b), key=sharpness.__getitem__) for a, b in itertools.pairwise(edges)}
    frames: list[FoundFrame] = []
    for index, picture in _frames(path):
        if index in chosen:
            target = folder / f"frame_{index:06d}.png"
            write_png(target, cv2.cvtColor(picture, cv2.COLOR_BGR2RGB))
            frames.append(FoundFrame(target.stem, target))
    return Found("video", frames, ordered=True)


def _sharpness(path: Path) -> list[float]:
    """Variance of the Laplacian of every frame."""
    values: list[float] = []
    for _, picture in _frames(path):
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        scale = EVEN_SIDE / max(grey.shape)
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else grey
        values.append(float(cv2.Laplacian(small, cv2.CV_64F).var()))
    return values


def _frames(path: Path):
    reader = cv2.VideoCapture(str(path))
    index = 0
    while True:
        good, picture = reader.read()
        if not good:
            break
        yield index, picture
        index += 1
    reader.release()
