"""From a volume to triangles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from inpaint3d.stages.usd_export.fusion import Volume


@dataclass(frozen=True, eq=False)
class Mesh:
    """Vertices [v, 3] float64 in scene units; triangles [t, 3] int64, counter-clockwise seen from free space."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def corners(self) -> NDArray[np.float64]:
        """The corners of every triangle, [t, 3, 3]."""
        return self.vertices[self.triangles]

    def normals(self) -> NDArray[np.float64]:
        """Unit normals [t, 3], towards free space; zero for a triangle without area."""
        a, b, c = self.corners().transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)


def extract(volume: Volume) -> Mesh:
    """The surface at distance 0, between corners that were seen (marching cubes, Lewiner et al. 2003).

    An empty mesh where the volume holds no surface.
    """
    from skimage.measure import marching_cubes

    seen = volume.weight > 0
    inside = volume.distance[seen]
    if inside.size == 0 or inside.min() >= 0 or inside.max() <= 0:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
    try:
        vertices, triangles, _, _ = marching_cubes(
            volume.distance, 0.0, mask=_find_whole_cells(seen), gradient_direction="descent"
        )
    except RuntimeError:  # seen corners of both signs, but never in one cell
        return Mesh(np.empty((0, 3)), np.empty((0, 3), np.int64))
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
