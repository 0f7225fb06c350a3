"""From a volume to triangles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from inpaint3d.scene.planes import Plane
from inpaint3d.stages.usd_export.fusion import Volume

ALIKE = np.cos(np.deg2rad(30))  # normals closer than this are of one plane


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices [v, 3] float64 in scene units; triangles [t, 3] int64, counter-clockwise seen from free space."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def corners(self) -> NDArray[np.float64]:
        """The corners of every triangle, [t, 3, 3]."""
        return self.vertices[self.triangles]

    def vertex_normals(self) -> NDArray[np.float64]:
        """Unit normals of the vertices [v, 3]: the mean of their triangles', by area; z where they cancel out."""
        a, b, c = self.corners().transpose(1, 0, 2)
        normals = np.zeros_like(self.vertices)
        for corner in self.triangles.T:
            np.add.at(normals, corner, np.cross(b - a, c - a))
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.where(length > 0, normals / np.where(length > 0, length, 1.0), (0.0, 0.0, 1.0))

    def normals(self) -> NDArray[np.float64]:
        """Unit normals [t, 3], towards free space; zero for a triangle without area."""
        a, b, c = self.corners().transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)


EMPTY = Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))


def extract(volume: Volume) -> Mesh:
    """The surface at distance 0, between known corners (marching cubes, Lewiner et al. 2003).

    An empty mesh where the volume holds no surface.
    """
    from skimage.measure import marching_cubes

    inside = volume.distance[volume.known]
    if inside.size == 0 or inside.min() >= 0 or inside.max() <= 0:
        return EMPTY
    try:
        vertices, triangles, _, _ = marching_cubes(
            volume.distance, 0.0, mask=_find_whole_cells(volume.known), gradient_direction="descent"
        )
    except RuntimeError:  # known corners of both signs, but never in one cell
        return EMPTY
    placed = volume.low + volume.cell * vertices.astype(np.float64)
    return remove_slivers(Mesh(placed, triangles.astype(np.int64)))


def _find_whole_cells(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells [x, y, z] of which all eight corners were seen, each at its last corner, where scikit-image looks."""
    whole = np.zeros_like(seen)
    cells = seen[1:, 1:, 1:].copy()
    for i, j, k in np.ndindex(2, 2, 2):
        cells &= seen[i : i + cells.shape[0], j : j + cells.shape[1], k : k + cells.shape[2]]
    whole[1:, 1:, 1:] = cells
    return whole


def remove_slivers(mesh: Mesh) -> Mesh:
    """Leave out triangles that have no area, then vertices that none uses."""
    a, b, c = mesh.corners().transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([np.linalg.norm(p - q, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    return compact(mesh.vertices, mesh.triangles[area > 1e-9 * np.square(longest)])


def remove_floaters(mesh: Mesh, smallest: float) -> Mesh:
    """Leave out connected pieces that hold less than the share `smallest` of all triangles."""
    if len(mesh.triangles) == 0:
        return mesh
    piece = label_pieces(len(mesh.vertices), mesh.triangles)[mesh.triangles[:, 0]]
    count = np.bincount(piece)
    return compact(mesh.vertices, mesh.triangles[count[piece] >= smallest * len(mesh.triangles)])


def label_pieces(vertices: int, triangles: NDArray[np.int64]) -> NDArray[np.int32]:
    """A number for each vertex, equal within a connected piece."""
    a, b, c = triangles.T
    first, second = np.concatenate([a, b]), np.concatenate([b, c])
    edges = coo_array((np.ones(len(first), bool), (first, second)), shape=(vertices, vertices))
    return connected_components(edges, directed=False)[1]


def compact(vertices: NDArray[np.float64], triangles: NDArray[np.int64]) -> Mesh:
    """The triangles with only the vertices that they use."""
    used, index = np.unique(triangles, return_inverse=True)
    return Mesh(vertices[used], index.reshape(triangles.shape).astype(np.int64))


def simplify(mesh: Mesh, triangles: int) -> Mesh:
    """At most about so many triangles, fewest where the surface is flat (quadric errors, Garland and Heckbert 1997)."""
    from fast_simplification import simplify as collapse

    if len(mesh.triangles) <= triangles:
        return mesh
    made = collapse(mesh.vertices, mesh.triangles.astype(np.int32), target_count=triangles, agg=5)
    return remove_slivers(Mesh(np.asarray(made[0], np.float64), np.asarray(made[1], np.int64)))


def keep_seen(mesh: Mesh, seen: NDArray[np.bool_]) -> Mesh:
    """The seen triangles [t], and the two rings around them, which no ray happened to meet."""
    for _ in range(2):
        vertices = np.zeros(len(mesh.vertices), bool)
        vertices[mesh.triangles[seen]] = True
        seen = np.any(vertices[mesh.triangles], axis=1, keepdims=True)[:, 0]
    return compact(mesh.vertices, mesh.triangles[seen])


def flatten(mesh: Mesh, planes: Sequence[Plane], tolerance: NDArray[np.float64]) -> Mesh:
    """Vertices within `tolerance` [v] of a plane that faces as they do lie on it."""
    vertices, normals = mesh.vertices.copy(), mesh.vertex_normals()
    free = np.ones(len(vertices), bool)
    for plane in planes:
        near = plane.distance(vertices) < tolerance
        held = free & near & (np.abs(normals @ plane.normal) > ALIKE)
        vertices[held] -= (vertices[held] @ plane.normal - plane.offset)[:, None] * plane.normal
        free &= ~held
    return Mesh(vertices, mesh.triangles)
