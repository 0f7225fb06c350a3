"""Cameras that a data set states, checked, and brought to the upright picture's own size."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.image_io import Header, read_header

# COLMAP's models and how many parameters they have (src/colmap/sensor/models.h); what is not here is refused by name.
PARAMETERS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5,
}  # fmt: skip
SUPPORTED: tuple[str, ...] = get_args(KnownCamera.model_fields["model"].annotation)
SINGLE_FOCAL = frozenset(["SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"])
ASPECT_TOLERANCE = 0.01
# Three printed decimals leave a rotation so far from orthonormal.
ROTATION_TOLERANCE = 5e-3
# Longest sides of the picture: beyond are angles of view of more than 160 degrees, and of less than a minute.
SHORTEST_FOCAL, LONGEST_FOCAL = 0.05, 5000.0
STRONGEST_BEND = 10.0  # of its distance from the middle: so far no lens moves the picture's corner
FARTHEST_CENTRE = 2.0  # picture sizes from the middle; crops of a larger picture have it outside
# Upright from stored axes, by EXIF orientation. The others mirror, which no camera does.
_TURNS = {
    1: np.array([[1.0, 0.0], [0.0, 1.0]]),
    3: np.array([[-1.0, 0.0], [0.0, -1.0]]),
    6: np.array([[0.0, -1.0], [1.0, 0.0]]),
    8: np.array([[0.0, 1.0], [-1.0, 0.0]]),
}


@dataclass(frozen=True)
class StatedLens:
    """A model's name and parameters in COLMAP's order, for pictures of `size` (width, height)."""

    model: str
    params: Sequence[float]
    size: tuple[float, float]


def same_aspect(a: tuple[float, float], b: tuple[float, float]) -> bool:
    """Whether sizes (width, height) have one aspect ratio, as far as whole pixels allow."""
    (w, h), (ow, oh) = sorted([a, b])
    return abs(w * oh / ow - h) <= max(1.0, ASPECT_TOLERANCE * h)


def stated_frame(header: Header, size: tuple[float, float]) -> tuple[tuple[int, int], int]:
    """The picture's size in the frame that a camera or mask of `size` is of, and the orientation left to be applied.

    Stored pixels before upright ones where both fit: the tools that write data sets take no notice of EXIF.
    ValueError where neither has its aspect ratio.
    """
    stored = (header.width, header.height)
    if same_aspect(size, stored):
        return stored, header.orientation
    if same_aspect(size, header.upright_size):
        return header.upright_size, 1
    raise ValueError(f"is for {size[0]:g}x{size[1]:g} but the picture is {stored[0]}x{stored[1]}, another aspect ratio")


def fit_camera(picture: Path, lens: StatedLens, world_from_cam: ArrayLike, document: str) -> KnownCamera:
    """The camera of a picture as it is shown: scaled to its size and turned as EXIF turns its pixels.

    `world_from_cam` [3 or 4, 4] has OpenCV's axes. BadInputError names the document and the picture.
    """
    try:
        _check_lens(lens)
        pose = _check_pose(world_from_cam)
        header = read_header(picture)
        (width, height), orientation = stated_frame(header, lens.size)
        if orientation not in _TURNS:
            raise ValueError(f"is of a picture that EXIF orientation {orientation} mirrors; save the picture upright")
    except ValueError as error:
        raise BadInputError(f"{document}: the camera of {picture.name} {error}; export it again") from error
    params = _scale(lens, width / lens.size[0], height / lens.size[1])
    turn = _TURNS[orientation]
    pose[:, :2] = pose[:, :2] @ turn.T
    turned = _turn(lens.model, params, turn, width, height) if orientation != 1 else params
    return KnownCamera(
        model=lens.model,  # pyright: ignore[reportArgumentType]
        params=tuple(turned),
        world_from_cam=as_pose(pose),
    )


class UnreadModelError(ValueError):
    """A camera model that is not read, with the way out."""


def check_model(model: str) -> None:
    """UnreadModelError for a camera model that is not read."""
    if model not in SUPPORTED:
        raise UnreadModelError(
            f"has the model {model}, which is not read ({', '.join(SUPPORTED)} are); undistort the pictures first "
            "(COLMAP's image_undistorter), or leave the cameras out to have them estimated"
        )


def _check_lens(lens: StatedLens) -> None:
    check_model(lens.model)
    if len(lens.params) != PARAMETERS[lens.model]:
        raise ValueError(f"has {len(lens.params)} parameters, but {lens.model} has {PARAMETERS[lens.model]}")
    if max(map(abs, lens.size)) > 2**32 or not np.isfinite([*lens.params, *lens.size]).all():
        raise ValueError(
            f"is not finite, or beyond any picture: {lens.model} {list(lens.params)} for {lens.size[0]}x{lens.size[1]}"
        )
    if min(lens.size) < 1:
        raise ValueError(f"is for a picture of {lens.size[0]:g}x{lens.size[1]:g} pixels")
    count = 1 if lens.model in SINGLE_FOCAL else 2
    focal, middle = lens.params[:count], lens.params[count : count + 2]
    longest = max(lens.size)
    if not SHORTEST_FOCAL * longest <= min(focal) <= max(focal) <= LONGEST_FOCAL * longest:
        wrong = min(focal) if min(focal) < SHORTEST_FOCAL * longest else max(focal)
        raise ValueError(
            f"has the focal length {wrong:g}; for {lens.size[0]:g}x{lens.size[1]:g} pixels it is "
            f"{SHORTEST_FOCAL * longest:g} to {LONGEST_FOCAL * longest:g}"
        )
    if any(abs(c - size / 2) > FARTHEST_CENTRE * size for c, size in zip(middle, lens.size, strict=True)):
        raise ValueError(
            f"has its principal point at {middle[0]:g}, {middle[1]:g}, far outside {lens.size[0]:g}x{lens.size[1]:g}"
        )
    radius = float(np.hypot(*lens.size)) / 2 / min(focal)
    further = lens.params[count + 2 :]
    if (bend := _bend(lens.model, further, radius)) > STRONGEST_BEND:
        raise ValueError(
            f"has the distortion {', '.join(f'{k:g}' for k in further)}, which moves the picture's corner by "
            f"{bend:.3g} times its distance from the middle"
        )


def _bend(model: str, further: Sequence[float], radius: float) -> float:
    """How far a lens moves what lies at `radius` (in focal lengths), as a share of it."""
    radial, tangential = (further[:2], further[2:]) if model == "OPENCV" else (further, ())
    along = sum(k * radius ** (2 * power) for power, k in enumerate(radial, 1))
    return abs(along) + 3 * radius * sum(map(abs, tangential))


def _check_pose(world_from_cam: ArrayLike) -> np.ndarray:
    pose = np.array(world_from_cam, np.float64)
    if pose.shape not in ((3, 4), (4, 4)):
        raise ValueError(f"has a pose of shape {list(pose.shape)}; it must be 3x4 or 4x4")
    pose = pose[:3]
    if not np.isfinite(pose).all():
        raise ValueError(f"has a pose with {int((~np.isfinite(pose)).sum())} values that are not finite")
    rotation = pose[:, :3]
    if np.abs(pose).max() > 1e12:
        raise ValueError(f"stands {np.abs(pose[:, 3]).max():g} from the origin")
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise ValueError(
            f"has no rotation in its pose (determinant {np.linalg.det(rotation):.3g}, axes off by {off:.2g}); "
            "a rotation has determinant 1"
        )
    return pose


def _scale(lens: StatedLens, x: float, y: float) -> list[float]:
    factors = [x, x, y] if lens.model in SINGLE_FOCAL else [x, y, x, y]
    factors += [1.0] * (len(lens.params) - len(factors))
    return [float(p) * f for p, f in zip(lens.params, factors, strict=True)]


def _turn(model: str, params: list[float], turn: np.ndarray, width: int, height: int) -> list[float]:
    """Parameters after a turn by quarters; radial distortion stays, tangential turns like a vector."""
    count = 1 if model in SINGLE_FOCAL else 2
    focal, (cx, cy), rest = params[:count], params[count : count + 2], params[count + 2 :]
    if turn[0, 0] == 0:
        focal = focal[::-1]
    middle = turn @ (cx - width / 2, cy - height / 2) + np.abs(turn) @ (width / 2, height / 2)
    if model == "OPENCV":  # k1, k2, p1, p2; (p2, p1) is the vector along x and y
        p2, p1 = turn @ (rest[3], rest[2])
        rest = [*rest[:2], float(p1), float(p2)]
    return [*focal, *map(float, middle), *rest]
