"""What rays meet of a mesh (Embree): depth maps, visibility, pictures, and the texels of a flattened mesh."""

from dataclasses import dataclass

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.cameras import Camera


@dataclass(frozen=True, eq=False)
class Hits:
    """For each ray the triangle it meets first, -1 for none [n]; barycentric coordinates there [n, 3]; distance [n]."""

    triangle: NDArray[np.int64]
    barycentric: NDArray[np.float64]
    distance: NDArray[np.float64]


class Caster:
    """A mesh, vertices [v, 3] and triangles [t, 3], that rays can be cast at."""

    def __init__(self, vertices: ArrayLike, triangles: ArrayLike) -> None:
        self._scene = EmbreeScene()
        corners = np.asarray(vertices, np.float32)[np.asarray(triangles)]
        TriangleMesh(self._scene, np.ascontiguousarray(corners))

    def cast(self, origins: ArrayLike, directions: ArrayLike) -> Hits:
        """Rays from `origins` along unit `directions`, both [n, 3]."""
        origins, directions = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
        found = self._scene.run(origins, directions, output=1)
        triangle = found["primID"].astype(np.int64)
        u, v = found["u"].astype(np.float64), found["v"].astype(np.float64)
        return Hits(triangle, np.stack([1 - u - v, u, v], -1), found["tfar"].astype(np.float64))

    def look(self, camera: Camera) -> Hits:
        """The rays through a camera's pixel centres, row by row."""
        origins, directions = (a.reshape(-1, 3) for a in camera.rays())
        return self.cast(origins, directions)

    def depth(self, camera: Camera) -> NDArray[np.float32]:
        """Depth along the axis at pixel centres [h, w]; 0 where nothing is."""
        hits = self.look(camera)
        z = hits.distance * (camera.rays()[1].reshape(-1, 3) @ camera.forward)
        return np.where(hits.triangle >= 0, z, 0.0).astype(np.float32).reshape(camera.height, camera.width)
