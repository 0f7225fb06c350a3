"""Meshes in a USD stage: the surface, volumes that guide, and what bodies collide with."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom, UsdPhysics, Vt

from inpaint3d.stages.usd_export.mesh import Mesh


def define_mesh(stage: Usd.Stage, path: str, mesh: Mesh) -> UsdGeom.Mesh:
    """A prim of flat triangles with its extent."""
    prim = UsdGeom.Mesh.Define(stage, path)
    points, triangles = mesh.vertices.astype(np.float32), mesh.triangles.astype(np.int32)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.ravel()))
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    prim.CreateExtentAttr(compute_extent(points))
    return prim


def write_collision(stage: Usd.Stage, path: str, pieces: Sequence[Mesh]) -> None:
    """Convex pieces that bodies collide with, one prim each.

    They stand in for the surface (purpose proxy), and hide: many viewers show proxies beside what is rendered.
    """
    if not pieces:
        return
    holder = UsdGeom.Xform.Define(stage, path)
    holder.CreatePurposeAttr(UsdGeom.Tokens.proxy)
    holder.CreateVisibilityAttr(UsdGeom.Tokens.invisible)
    for number, piece in enumerate(pieces):
        prim = define_mesh(stage, f"{path}/Piece_{number:03d}", piece).GetPrim()
        UsdPhysics.CollisionAPI.Apply(prim)
        UsdPhysics.MeshCollisionAPI.Apply(prim).CreateApproximationAttr(UsdPhysics.Tokens.convexHull)


def compute_extent(points: NDArray[np.floating], margin: float = 0.0) -> Vt.Vec3fArray:
    """The box of points [n, 3], grown by `margin` on all sides; empty at the origin without points."""
    if len(points) == 0:
        return Vt.Vec3fArray([Gf.Vec3f(0.0), Gf.Vec3f(0.0)])
    low, high = points.min(0) - margin, points.max(0) + margin
    return Vt.Vec3fArray([Gf.Vec3f(*map(float, low)), Gf.Vec3f(*map(float, high))])
