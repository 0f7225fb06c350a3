"""From the views' depth to the mesh that is exported: fused, without what no view shows, flat and few triangles."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.planes import fit_planes
from inpaint3d.stages.usd_export.contraction import contract, expand, measure_stretch
from inpaint3d.stages.usd_export.fusion import Box, corners, fuse
from inpaint3d.stages.usd_export.mesh import Mesh, extract, flatten, keep_seen, remove_floaters, simplify
from inpaint3d.stages.usd_export.rays import Caster

FLAT = 1.0  # cells that a plane's vertices may lie off it
PLANE_SAMPLE = 8000  # vertices that planes are looked for among


def bounds_of(views: Sequence[SurfaceView]) -> Box:
    """Corners of the box of contracted space that holds all surfaces seen, but for outliers."""
    points = [
        view.camera.unproject(view.camera.pixel_centres()[view.depth > 0], view.depth[view.depth > 0]) for view in views
    ]
    every = contract(np.concatenate(points))
    low, high = np.quantile(every, [0.0005, 0.9995], axis=0)
    margin = 0.02 * float((high - low).max()) + 1e-3
    return low - margin, high + margin


def make_surface(
    views: Sequence[SurfaceView], box: Box, *, grid: int, truncation_cells: float, smallest_piece: float, triangles: int
) -> Mesh:
    """The mesh of what the views see, in scene units; empty without a surface."""
    fused = extract(fuse(views, box, grid=grid, truncation_cells=truncation_cells))
    if len(fused.triangles) == 0:
        return fused
    mesh = remove_floaters(keep_seen(fused, find_seen(_unfold(fused), views)), smallest_piece)
    cell, _ = corners(*box, grid)
    scene = _straighten(_unfold(mesh), cell)
    # Far away, triangles are as large as cells are: simplified in contracted space, where cells are all alike.
    few = simplify(Mesh(contract(scene.vertices), scene.triangles), triangles)
    return _straighten(_unfold(few), cell)


def find_seen(mesh: Mesh, views: Sequence[SurfaceView]) -> NDArray[np.bool_]:
    """Which triangles [t] a ray through a pixel of some view meets first."""
    caster, seen = Caster(mesh.vertices, mesh.triangles), np.zeros(len(mesh.triangles), bool)
    for view in views:
        met = caster.look(view.camera).triangle
        seen[met[met >= 0]] = True
    return seen


def _unfold(mesh: Mesh) -> Mesh:
    return Mesh(expand(mesh.vertices), mesh.triangles)


def _straighten(mesh: Mesh, cell: float) -> Mesh:
    """Bring what is nearly flat onto the planes that it shows: depth is noisy, walls and table tops are not."""
    off = FLAT * cell
    sample = mesh.vertices[:: max(1, len(mesh.vertices) // PLANE_SAMPLE)]
    return flatten(mesh, fit_planes(sample, off), off * measure_stretch(mesh.vertices))
