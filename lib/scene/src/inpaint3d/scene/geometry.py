"""Rays against simple volumes, and similarity transforms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def ray_sphere(
    origins: ArrayLike, directions: ArrayLike, centre: ArrayLike, radius: float
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Where rays enter and leave a sphere, and whether they meet it in front of their origin.

    origins, directions: [*n, 3], directions of unit length. Returns t_near, t_far [*n] (scene units along the ray;
    t_near is 0 for an origin inside) and hit [*n]; t is inf where there is no hit.
    """
    directions = np.asarray(directions, np.float64)
    offset = np.asarray(origins, np.float64) - np.asarray(centre, np.float64)
    along = np.sum(offset * directions, -1)
    # Distance of the line from the centre by the perpendicular, not |offset|^2 - along^2: that loses all its digits
    # for a small sphere far away.
    perpendicular = offset - along[..., None] * directions
    with np.errstate(over="ignore", invalid="ignore"):  # squares beyond 1e308: all is inside, or nothing is met
        half_squared = np.square(np.float64(radius)) - np.sum(perpendicular**2, -1)
    half = np.sqrt(np.maximum(half_squared, 0.0))
    t_near, t_far = -along - half, -along + half
    hit = (half_squared >= 0) & (t_far > 0)
    return np.where(hit, np.maximum(t_near, 0.0), np.inf), np.where(hit, t_far, np.inf), hit


def ray_box(
    origins: ArrayLike, directions: ArrayLike, centre: ArrayLike, size: ArrayLike, yaw_deg: float = 0.0
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Where rays enter and leave a box (full sides `size`) turned about z by `yaw_deg`; returns as `ray_sphere`."""
    box_from_world = rotation_about_z(-yaw_deg)
    origins = (np.asarray(origins, np.float64) - np.asarray(centre, np.float64)) @ box_from_world.T
    directions = np.asarray(directions, np.float64) @ box_from_world.T
    half = np.asarray(size, np.float64) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        t0, t1 = (-half - origins) / directions, (half - origins) / directions
    # 0/0 where the ray lies in the plane of a face: that pair of faces does not limit it.
    low = np.where(np.isnan(t0) | np.isnan(t1), -np.inf, np.minimum(t0, t1)).max(-1)
    high = np.where(np.isnan(t0) | np.isnan(t1), np.inf, np.maximum(t0, t1)).min(-1)
    hit = (low <= high) & (high > 0)
    return np.where(hit, np.maximum(low, 0.0), np.inf), np.where(hit, high, np.inf), hit


def rotation_about_z(degrees: float) -> Floats:
    """Counter-clockwise seen from +z, [3, 3]."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotation_between(a: ArrayLike, b: ArrayLike) -> Floats:
    """The smallest rotation [3, 3] that takes direction `a` to direction `b` (Rodrigues)."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    cosine = float(a @ b)
    if cosine < -1 + 1e-12:  # opposite: any axis across `a` will do
        axis = np.cross(a, np.eye(3)[np.argmin(np.abs(a))])
        axis /= np.linalg.norm(axis)
        half_turn = 2 * axis[:, None] * axis - np.eye(3)
        return np.asarray(half_turn, np.float64)
    v = np.cross(a, b)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + cross + cross @ cross / (1 + cosine)


@dataclass(frozen=True, eq=False)
class Similarity:
    """target = scale * rotation @ source + translation."""

    scale: float
    rotation: Floats
    translation: Floats

    def points(self, xyz: ArrayLike) -> Floats:
        """Points [*n, 3] in the target frame."""
        return self.scale * (np.asarray(xyz, np.float64) @ self.rotation.T) + self.translation

    def pose(self, world_from_cam: ArrayLike) -> Floats:
        """A camera's pose [3, 4] in the target frame: its centre moves and scales, its axes only turn."""
        pose = np.asarray(world_from_cam, np.float64)[:3]
        return np.concatenate([self.rotation @ pose[:, :3], self.points(pose[:, 3])[:, None]], 1)

    def inverse(self) -> "Similarity":
        back = self.rotation.T
        return Similarity(1 / self.scale, back, -(back @ self.translation) / self.scale)

    def then(self, other: "Similarity") -> "Similarity":
        """The similarity that is this one, and the other after it."""
        return Similarity(other.scale * self.scale, other.rotation @ self.rotation, other.points(self.translation))

    @property
    def matrix(self) -> Floats:
        """[3, 4] with the scale in its left part: target = M[:, :3] @ source + M[:, 3]."""
        return np.concatenate([self.scale * self.rotation, self.translation[:, None]], 1)


def nearest_point_to_axes(
    origins: ArrayLike, directions: ArrayLike, weights: ArrayLike | None = None, rounds: int = 10
) -> Floats:
    """The point [3] nearest to lines through `origins` [n, 3] along unit `directions` [n, 3], robustly.

    Least squares over perpendicular distances, reweighted by 1 / distance (Weiszfeld) so that a few cameras that
    look elsewhere don't pull it away. A small ridge towards the origins' mean keeps parallel axes solvable.
    """
    origins, directions = np.asarray(origins, np.float64), np.asarray(directions, np.float64)
    given = np.ones(len(origins)) if weights is None else np.asarray(weights, np.float64)
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    mean = np.average(origins, 0, weights=given)
    spread = float(np.sqrt(np.mean(np.sum((origins - mean) ** 2, -1)))) or 1.0
    weight = given
    point = mean
    for _ in range(rounds):
        ridge = 1e-6 * weight.sum()
        lhs = np.einsum("n,nij->ij", weight, across) + ridge * np.eye(3)
        rhs = np.einsum("n,nij,nj->i", weight, across, origins) + ridge * mean
        point = np.linalg.solve(lhs, rhs)
        distance = np.linalg.norm(np.einsum("nij,nj->ni", across, point - origins), axis=-1)
        weight = given / (distance + 0.02 * spread)
    return point
