"""What bodies collide with: convex pieces around a surface (V-HACD, Mamou 2016, in the library's version 4)."""

import numpy as np
from numpy.typing import NDArray
from vhacdx import compute_vhacd

from inpaint3d.stages.usd_export.mesh import Mesh, compact

NEAR = 2.0  # scene units from the origin: what is farther from the cameras, in the unit ball, is scenery
VOXELS = 400_000
MAX_CORNERS = 32  # of a piece: half of what physics engines take


def split_convex(mesh: Mesh, most: int) -> list[Mesh]:
    """At most so many convex pieces that together cover the near part of a mesh; none where nothing is near.

    The surface is filled where it lies, not what it encloses: a room stays hollow. Between two pieces' corners a piece
    lies a little before the surface where that is concave.
    """
    near = (np.linalg.norm(mesh.corners(), axis=-1) < NEAR).all(-1)
    if most == 0 or not near.any():
        return []
    part = compact(mesh.vertices, mesh.triangles[near])
    faces = np.insert(part.triangles, 0, 3, axis=1).astype(np.uint32)
    pieces = compute_vhacd(
        part.vertices,
        faces.ravel(),
        maxConvexHulls=most,
        resolution=VOXELS,
        fillMode="surface",
        maxNumVerticesPerCH=MAX_CORNERS,
        asyncACD=False,  # in one thread pieces come in one order
    )
    return [Mesh(np.asarray(corners, np.float64), _to_triangles(faces)) for corners, faces in pieces]


def _to_triangles(faces: NDArray[np.uint32]) -> NDArray[np.int64]:
    return np.asarray(faces, np.int64).reshape(-1, 3)
