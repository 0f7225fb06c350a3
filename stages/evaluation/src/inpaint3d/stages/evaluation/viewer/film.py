"""A film of the way around: the capture's cameras in order, with as many between them as the time asks for."""

from collections.abc import Callable, Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, Slerp

from inpaint3d.contracts.errors import BadInputError, StorageError
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.colour import to_bytes
from inpaint3d.stages.evaluation.viewer.scene import ViewerScene, draw_map

CODECS = {".mp4": "mp4v", ".webm": "VP80", ".avi": "MJPG"}


def interpolate(cameras: Sequence[Camera], count: int, width: int) -> list[Camera]:
    """`count` cameras along the given ones, `width` pixels wide and even in height: places by a curve without overshoot
    (PCHIP), rotations along great circles. BadInputError with fewer than two cameras.
    """
    if len(cameras) < 2:
        raise BadInputError(f"a way around needs two cameras; there is {len(cameras)}")
    at, times = np.arange(len(cameras)), np.linspace(0, len(cameras) - 1, count)
    centres = PchipInterpolator(at, np.stack([c.centre for c in cameras]))(times)
    rotations = Slerp(at, Rotation.from_matrix(np.stack([c.rotation for c in cameras])))(times).as_matrix()
    first = cameras[0]
    height = 2 * round(width * first.height / first.width / 2)
    f = first.fx / first.width * width
    poses = np.concatenate([rotations, centres[..., None]], axis=-1)
    return [Camera(f, f, width / 2, height / 2, width, height, pose) for pose in poses]


def write_film(
    file: Path, scene: ViewerScene, name: str, kind: str, cameras: Sequence[Camera], *, rate: float,
    tick: Callable[[int, int], None],
) -> None:  # fmt: skip
    """Render a field along the cameras. BadInputError for a suffix that stands for no codec."""
    if file.suffix not in CODECS:
        raise BadInputError(f"--out {file}: a film ends in {', '.join(CODECS)}")
    size = (cameras[0].width, cameras[0].height)
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*CODECS[file.suffix]), rate, size)
    if not writer.isOpened():
        raise StorageError(f"{file} cannot be written; choose another folder, or another suffix")
    for index, camera in enumerate(cameras):
        tick(index, len(cameras))
        writer.write(np.ascontiguousarray(to_bytes(draw_map(render_view(scene.fields[name], camera), kind))[..., ::-1]))
    writer.release()
