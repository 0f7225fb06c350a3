"""Planes among points: walls, floors and table tops, found in what is triangulated of a scene."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask

Array = NDArray[np.float64]

PLANE_PIXELS = 1.5
"""Pixels that a sparse point on a plane may lie off it, seen at the middle depth."""
TRIALS = 500
"""Triples of points that are tried for one plane."""
MIN_POINTS = 60
"""Points on a plane, at least."""
MAX_PLANES = 12
MAX_REFITS = 50
"""Rounds in which a plane is fitted anew to the points within the tolerance; some 15 settle it."""
MIN_CONTRAST = 0.6
"""Share of the points within three times the tolerance that lie within one: a third in clutter, 1 on a clean plane."""
MIN_BREADTH = 5.0
"""How many times the tolerance the points of a plane spread in the narrower of its directions, standard deviation."""


@dataclass(frozen=True, eq=False)
class Plane:
    """All x with normal . x = offset; normal [3] has unit length, offset is in scene units."""

    normal: Array
    offset: float

    @classmethod
    def fit(cls, points: Array) -> "Plane":
        """The plane of least squared distances to points [n, 3], n >= 3."""
        middle = points.mean(0)
        normal = np.linalg.svd(points - middle, full_matrices=False)[2][2]
        return cls(normal, float(normal @ middle))

    def distance(self, points: Array) -> Array:
        """How far points [..., 3] lie off it, scene units."""
        return np.abs(points @ self.normal - self.offset)

    def depth(self, camera: Camera, pixels: Array) -> Array:
        """Depth z at which a camera sees it at pixels [n, 2]; inf where it does not."""
        towards = camera.unproject(pixels, np.ones(len(pixels))) - camera.centre
        ahead, off = towards @ self.normal, self.offset - camera.centre @ self.normal
        depth = np.divide(off, ahead, out=np.full(len(pixels), np.inf), where=ahead != 0)
        return np.where(depth > 0, depth, np.inf)


def fit_planes(points: NDArray[np.floating], tolerance: float) -> list[Plane]:
    """Planes that hold at least MIN_POINTS of the points [n, 3] within `tolerance` (scene units), largest first.

    Random sample consensus (Fischler and Bolles 1981, doi:10.1145/358669.358692), one plane after another, each fitted
    anew to its points until these stay the same (as in Chum et al. 2003, doi:10.1007/978-3-540-45243-0_31). A slab of
    cluttered points is none, since as many lie beside it as in it, and neither is a row of points, which lie on planes
    of any direction. The same points give the same planes.
    """
    rng = np.random.default_rng(0)
    rest, planes = points.astype(np.float64), list[Plane]()
    for _ in range(MAX_PLANES):
        if len(rest) < MIN_POINTS or (inside := _find_consensus(rest, tolerance, rng)).sum() < MIN_POINTS:
            break
        plane, inside = _refit(rest, inside, tolerance)
        around = plane.distance(points.astype(np.float64)) < 3 * tolerance
        if inside.sum() >= MIN_CONTRAST * around.sum() and _measure_breadth(rest[inside]) > MIN_BREADTH * tolerance:
            planes.append(plane)
        rest = rest[~inside]
    return planes


def _refit(points: Array, inside: Mask, tolerance: float) -> tuple[Plane, Mask]:
    """The plane of the points `inside` [n], and which of all the points [n, 3] lie within tolerance of it.

    Three points lie off their plane as any do, so that what agrees with them is a slice askew through its points, and
    the plane of that slice is askew as well: by degrees, where the points are as noisy as the tolerance allows.
    """
    plane = Plane.fit(points[inside])
    for _ in range(MAX_REFITS):
        within = plane.distance(points) < tolerance
        if (within == inside).all() or within.sum() < MIN_POINTS:
            break
        plane, inside = Plane.fit(points[within]), within
    return plane, inside


def _measure_breadth(points: Array) -> float:
    """Standard deviation of points [n, 3] along the second of their principal directions."""
    return float(np.linalg.svd(points - points.mean(0), compute_uv=False)[1] / np.sqrt(len(points)))


def _find_consensus(points: Array, tolerance: float, rng: np.random.Generator) -> Mask:
    """Which points the plane through three of them has within tolerance, for the best of some triples."""
    best = np.zeros(len(points), bool)
    for _ in range(TRIALS):
        first, second, third = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(second - first, third - first)
        length = np.linalg.norm(normal)
        # Three points that are nearly one, or in a line, tell of no plane.
        if length <= tolerance**2:
            continue
        inside = np.abs((points - first) @ (normal / length)) < tolerance
        if inside.sum() > best.sum():
            best = inside
    return best
