"""How far cameras agree with their pictures: the share of verified matches that the cameras' geometry allows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from numpy.typing import NDArray

from inpaint3d.stages.pose_estimation.matches import VerifiedPair

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

# Rays of less than this angle (radians) meet anywhere: noise decides on which side of the cameras.
PARALLEL = 0.01


@dataclass(frozen=True, eq=False)
class Cameras:
    """A lens and a pose (world_from_cam [3, 4]) for each view."""

    lenses: list[pycolmap.Camera]
    world_from_cam: list[Floats]


@dataclass(frozen=True, eq=False)
class Agreement:
    """Verified matches of each view [n], how many of them the cameras allow, and how far matches usually are off."""

    allowed: NDArray[np.int64]
    verified: NDArray[np.int64]
    median_distance: float
    """Share of the longest side; 0 where there is no match."""

    @property
    def share(self) -> float:
        """Over all views; 1 where there is no match to judge by."""
        return float(self.allowed.sum() / self.verified.sum()) if self.verified.any() else 1.0

    @property
    def by_view(self) -> Floats:
        """Of each view [n]; 1 where it has no match."""
        return np.where(self.verified > 0, self.allowed / np.maximum(self.verified, 1), 1.0)


def measure_agreement(pairs: Sequence[VerifiedPair], cameras: Cameras, tolerance: float) -> Agreement:
    """A match is allowed within `tolerance`, a share of the longest side; it counts for both of its views."""
    counts = np.zeros((2, len(cameras.lenses)), np.int64)
    distances = [measure_distances(pair, cameras) for pair in pairs]
    for pair, distance in zip(pairs, distances, strict=True):
        counts[:, [pair.first, pair.second]] += [[np.sum(distance <= tolerance)], [len(pair)]]
    return Agreement(counts[0], counts[1], float(np.median(np.concatenate(distances))) if distances else 0.0)


def measure_distances(pair: VerifiedPair, cameras: Cameras) -> Floats:
    """How far the rays of each match [m] miss each other, as a share of the pictures' longest sides.

    Sampson's distance, of first order in the epipolar constraint (Hartley and Zisserman, 2004, eq. 11.9); inf where
    the rays meet behind a camera.
    """
    lenses = [cameras.lenses[view] for view in (pair.first, pair.second)]
    first, second = (cameras.world_from_cam[view] for view in (pair.first, pair.second))
    rays = [_cast_rays(lens, xy) for lens, xy in zip(lenses, (pair.first_xy, pair.second_xy), strict=True)]
    relative, baseline = second[:, :3].T @ first[:, :3], second[:, :3].T @ (first[:, 3] - second[:, 3])
    essential = _make_cross_matrix(baseline) @ relative
    lines = rays[1] @ essential, rays[0] @ essential.T
    value = np.abs(np.sum(rays[1] * lines[1], 1))
    slope = sum(
        (max(lens.width, lens.height) / lens.mean_focal_length()) ** 2 * (np.sum(line**2, 1) - value**2)
        for lens, line in zip(lenses, lines, strict=True)
    )
    possible = _are_in_front(rays[0] @ relative.T, rays[1], baseline)
    # Without a baseline every ray meets every other in the camera: what is left to be judged is their direction.
    return np.where(possible, value / np.sqrt(np.where(slope > 0, slope, 1.0)), np.inf)


def _cast_rays(lens: pycolmap.Camera, xy: Floats) -> Floats:
    """Rays [m, 3] of captured pixels in the camera's axes, of length 1: a pixel is an angle, also in a fisheye."""
    plane = np.asarray(lens.cam_from_img(np.ascontiguousarray(xy)), np.float64)
    rays = np.concatenate([plane, np.ones((len(plane), 1))], 1)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _are_in_front(first: Floats, second: Floats, baseline: Floats) -> Flags:
    """Whether depth_second * second = depth_first * first + baseline has positive depths, or the rays are parallel."""
    a, b, c = (np.sum(p * q, 1) for p, q in ((first, first), (first, second), (second, second)))
    gram = a * c - b**2  # |first x second|^2
    d, e = first @ baseline, second @ baseline
    depth_first, depth_second = b * e - c * d, a * e - b * d
    parallel = gram <= PARALLEL**2 * a * c
    return parallel | ((depth_first > 0) & (depth_second > 0))


def _make_cross_matrix(v: Floats) -> Floats:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
