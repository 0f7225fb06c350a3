"""What bodies collide with: convex pieces that lie where the surface lies."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from inpaint3d.stages.usd_export.collision import NEAR, split_convex
from inpaint3d.stages.usd_export.mesh import Mesh

SIDE = 12


def sheet(corner: tuple[float, float, float], u: tuple[float, float, float], v: tuple[float, float, float]) -> Mesh:
    i, j = np.mgrid[:SIDE, :SIDE].reshape(2, -1) / (SIDE - 1)
    points = np.array(corner) + i[:, None] * u + j[:, None] * v
    a = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    halves = [np.stack([a, a + SIDE, a + SIDE + 1], 1), np.stack([a, a + SIDE + 1, a + 1], 1)]
    return Mesh(points, np.concatenate(halves))


def join(*meshes: Mesh) -> Mesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.triangles + start for m, start in zip(meshes, starts, strict=False)]),
    )


FLOOR = sheet((-0.5, -0.5, 0), (1, 0, 0), (0, 1, 0))
WALL = sheet((-0.5, 0.5, 0), (1, 0, 0), (0, 0, 1))
SIDE_WALL = sheet((-0.5, -0.5, 0), (0, 1, 0), (0, 0, 1))
ROOM = join(FLOOR, WALL, SIDE_WALL)


def depth_inside(points: NDArray[np.float64], pieces: list[Mesh]) -> NDArray[np.float64]:
    """How deep points lie in the piece that holds them most; negative outside of all."""
    faces = [ConvexHull(p.vertices, qhull_options="QJ").equations for p in pieces]
    return np.max([-(points @ e[:, :3].T + e[:, 3]).max(1) for e in faces], 0)


def test_pieces_cover_the_surface_and_leave_the_room_free() -> None:
    pieces = split_convex(ROOM, 32)
    assert 3 <= len(pieces) <= 32
    assert depth_inside(ROOM.corners().mean(1), pieces).min() > -0.03
    grid = np.stack(np.meshgrid(*[np.linspace(-0.3, 0.3, 7)] * 2, np.linspace(0.2, 0.8, 7)), -1).reshape(-1, 3)
    assert depth_inside(grid, pieces).max() < 0


def test_pieces_are_convex_and_repeat() -> None:
    first, again = split_convex(ROOM, 16), split_convex(ROOM, 16)
    for one, other in zip(first, again, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)
        hull = ConvexHull(one.vertices, qhull_options="QJ")
        a, b, c = one.corners().transpose(1, 0, 2)
        volume = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
        np.testing.assert_allclose(abs(volume), hull.volume, rtol=0.02, atol=1e-6)


def test_scenery_is_left_alone() -> None:
    far = Mesh(FLOOR.vertices + np.array([0, 0, 2 * NEAR]), FLOOR.triangles)
    assert split_convex(far, 8) == []
    assert depth_inside(far.vertices, split_convex(join(ROOM, far), 8)).max() < 0
    assert split_convex(ROOM, 0) == []
