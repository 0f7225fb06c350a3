"""Conventions of camera axes, all brought to OpenCV's (x right, y down, z forward)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.cameras import as_pose

OPENCV_FROM_OPENGL = np.diag([1.0, -1.0, -1.0])
# LLFF stores the axes down, right, backwards as the columns of a pose.
OPENCV_FROM_LLFF = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def from_opengl(world_from_cam: ArrayLike):
    """Pose of an OpenGL camera (y up, z backwards), 3x4 or 4x4, as OpenCV's."""
    return _turn(world_from_cam, OPENCV_FROM_OPENGL)


def from_llff(world_from_cam: ArrayLike):
    """Pose of an LLFF camera (columns down, right, backwards) as OpenCV's."""
    return _turn(world_from_cam, OPENCV_FROM_LLFF)


def _turn(world_from_cam: ArrayLike, turn: NDArray[np.float64]):
    pose = np.asarray(world_from_cam, np.float64)[:3]
    with np.errstate(invalid="ignore"):  # what is not finite is refused by name, with its frame
        return as_pose(np.concatenate([pose[:, :3] @ turn, pose[:, 3:]], 1))
