"""Charts of a mesh in a texture (xatlas), and which point of the mesh each texel shows."""

from dataclasses import dataclass

import numpy as np
import xatlas
from numpy.typing import NDArray

from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.rays import Caster

PADDING = 3  # texels between charts: a bilinear footprint of one never meets the other's
CHART_COST = 4.0  # how far a chart may bend and stretch; larger ones take longer to grow


@dataclass(frozen=True, eq=False)
class Atlas:
    """Texture coordinates of every triangle's corners [t, 3, 2], u to the right and v upwards, as USD has it."""

    coordinates: NDArray[np.float32]
    charts: int


@dataclass(frozen=True, eq=False)
class Texels:
    """The texels that the mesh uses: row and column [n], triangle [n], barycentric coordinates [n, 3]."""

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    triangle: NDArray[np.int64]
    barycentric: NDArray[np.float64]


def unwrap(mesh: Mesh, size: int) -> Atlas:
    """Cut and flatten a mesh into charts that fill a square texture of `size` texels, each as large as on the mesh."""
    made = xatlas.Atlas()
    made.add_mesh(mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32))
    charts, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    charts.max_cost = CHART_COST
    packing.resolution, packing.padding = size, PADDING
    made.generate(charts, packing)
    _, index, uv = made[0]
    # The packer keeps roughly to the size asked for; its texels are scaled to a square of just that size.
    texel = uv * np.array([made.width, made.height]) * (1 / max(made.width, made.height))
    return Atlas(texel[index].astype(np.float32), made.chart_count)


def find_texels(atlas: Atlas, size: int) -> Texels:
    """The texels whose centre lies in a triangle, in rows from the top of the texture."""
    flat = np.zeros((*atlas.coordinates.shape[:2], 3))
    flat[..., :2] = atlas.coordinates * size
    row, column = (a.ravel() for a in np.indices((size, size)))
    origins = np.stack([column + 0.5, size - row - 0.5, np.ones(size * size)], -1)
    corners = np.arange(flat.shape[0] * 3).reshape(-1, 3)
    hits = Caster(flat.reshape(-1, 3), corners).cast(origins, np.broadcast_to([0.0, 0.0, -1.0], origins.shape))
    used = hits.triangle >= 0
    return Texels(row[used], column[used], hits.triangle[used], hits.barycentric[used])
