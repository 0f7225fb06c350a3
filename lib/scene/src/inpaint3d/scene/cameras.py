"""The pinhole camera: OpenCV axes (x right, y down, z forward), pixel centres at +0.5.

Pixel (0, 0) covers [0, 1) x [0, 1), so that the middle of a picture is (width / 2, height / 2).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.models.artifacts import PosedFrame
from inpaint3d.contracts.models.base import Pose

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera; focal lengths and centre in pixels, `world_from_cam` float64 [3, 4]."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    world_from_cam: Floats

    def __post_init__(self) -> None:
        pose = np.array(self.world_from_cam, np.float64)
        if pose.shape not in ((3, 4), (4, 4)):
            raise ValueError(f"world_from_cam is {pose.shape}; it must be 3x4 or 4x4")
        pose = pose[:3]
        pose.setflags(write=False)
        object.__setattr__(self, "world_from_cam", pose)

    @classmethod
    def from_model(cls, frame: PosedFrame) -> "Camera":
        return cls(frame.fx, frame.fy, frame.cx, frame.cy, frame.width, frame.height, np.array(frame.world_from_cam))

    @property
    def rotation(self) -> Floats:
        """World from camera, [3, 3]; its columns are right, down and forward in the world."""
        return self.world_from_cam[:, :3]

    @property
    def centre(self) -> Floats:
        """Where the camera stands, [3]."""
        return self.world_from_cam[:, 3]

    @property
    def forward(self) -> Floats:
        """Unit optical axis in the world, [3]."""
        return self.world_from_cam[:, 2]

    @property
    def intrinsics(self) -> Floats:
        """The matrix K, [3, 3]."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], np.float64)

    @cached_property
    def cam_from_world(self) -> Floats:
        """Inverse of the rigid `world_from_cam`, [3, 4]."""
        return np.concatenate([self.rotation.T, -(self.rotation.T @ self.centre)[:, None]], 1)

    @property
    def pose(self) -> Pose:
        """`world_from_cam` as the contracts store it."""
        return as_pose(self.world_from_cam)

    def pixel_centres(self) -> Floats:
        """Every pixel's centre, [h, w, 2]."""
        x, y = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        return np.stack([x, y], -1).astype(np.float64)

    def rays(self, xy: ArrayLike | None = None) -> tuple[Floats, Floats]:
        """Origins and unit directions of the rays through `xy` [*n, 2] (default: pixel centres [h, w, 2])."""
        xy = self.pixel_centres() if xy is None else np.asarray(xy, np.float64)
        directions = self._unproject_flat(xy) @ self.rotation.T
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
        return np.broadcast_to(self.centre, directions.shape), directions

    def project(self, points: ArrayLike) -> tuple[Floats, Floats]:
        """Pixels [*n, 2] and depths along the axis [*n] of world points [*n, 3].

        Points behind the camera have z <= 0 and pixels that mean nothing; on its plane they are infinite.
        """
        in_cam = (np.asarray(points, np.float64) - self.centre) @ self.rotation
        z = in_cam[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = in_cam[..., :2] / z[..., None] * (self.fx, self.fy) + (self.cx, self.cy)
        return xy, z

    def unproject(self, xy: ArrayLike, z: ArrayLike) -> Floats:
        """World points [*n, 3] at depth `z` [*n] along the axis behind pixels `xy` [*n, 2]."""
        in_cam = self._unproject_flat(np.asarray(xy, np.float64)) * np.asarray(z, np.float64)[..., None]
        return in_cam @ self.rotation.T + self.centre

    def inside(self, xy: ArrayLike, z: ArrayLike) -> NDArray[np.bool_]:
        """Whether projections fall in the picture and in front of the camera, [*n]."""
        xy = np.asarray(xy)
        # Comparisons with NaN are False, so that points on the camera's plane count as outside.
        return (
            (np.asarray(z) > 0)
            & (xy[..., 0] >= 0)
            & (xy[..., 0] < self.width)
            & (xy[..., 1] >= 0)
            & (xy[..., 1] < self.height)
        )

    def resize_to(self, width: int, height: int) -> "Camera":
        """The same camera with its picture resampled to another size."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
            width=width,
            height=height,
        )

    def _unproject_flat(self, xy: Floats) -> Floats:
        """Points of the plane z = 1 behind pixels, [*n, 3]."""
        plane = (xy - (self.cx, self.cy)) / (self.fx, self.fy)
        return np.concatenate([plane, np.ones_like(plane[..., :1])], -1)


def as_pose(matrix: ArrayLike) -> Pose:
    """The first three rows of a 3x4 or 4x4 matrix as plain floats."""
    rows = [tuple(float(v) for v in row) for row in np.asarray(matrix, np.float64)[:3]]
    return (rows[0], rows[1], rows[2])  # pyright: ignore[reportReturnType]


def look_at(centre: ArrayLike, target: ArrayLike, up: ArrayLike = (0.0, 0.0, 1.0)) -> Floats:
    """`world_from_cam` [3, 4] of a camera at `centre` that looks at `target` with `up` upwards in its picture."""
    centre = np.asarray(centre, np.float64)
    forward = np.asarray(target, np.float64) - centre
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, np.asarray(up, np.float64))
    length = np.linalg.norm(right)
    if length < 1e-9:
        raise ValueError("up is along the line of sight; name another up")
    right /= length
    return np.stack([right, np.cross(forward, right), forward, centre], 1)


def measure_apart(one: Camera, other: Camera) -> float:
    """How differently two cameras look: distance of their centres, and of their axes' unit vectors."""
    return float(np.linalg.norm(one.centre - other.centre) + np.linalg.norm(one.forward - other.forward))
