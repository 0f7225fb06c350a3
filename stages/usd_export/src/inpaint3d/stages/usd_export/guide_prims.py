"""What helps people in a USD stage and is never rendered: the mask's volumes, and the sparse points."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import numpy as np
from pxr import Gf, Usd, UsdGeom, Vt

from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.scene.capture_io import SparsePoints
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.mesh_prims import compute_extent, define_mesh

POINT_WIDTH = 0.005  # scene units


def write_points(stage: Usd.Stage, path: str, points: SparsePoints) -> None:
    """The sparse points that the cameras were found with, in their colours."""
    prim = UsdGeom.Points.Define(stage, path)
    prim.CreatePurposeAttr(UsdGeom.Tokens.guide)
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.xyz))
    prim.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.full(len(points), POINT_WIDTH, np.float32)))
    prim.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    colours = (points.rgb / 255).astype(np.float32)
    prim.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex).Set(Vt.Vec3fArray.FromNumpy(colours))
    prim.CreateExtentAttr(compute_extent(points.xyz, POINT_WIDTH / 2))


def write_mask(stage: Usd.Stage, path: str, primitives: Sequence[Primitive], hull: Mesh | None) -> None:
    """The mask's volumes: its primitives, or the hull of its views."""
    if not primitives and hull is None:
        return
    holder = UsdGeom.Xform.Define(stage, path)
    holder.CreatePurposeAttr(UsdGeom.Tokens.guide)
    for i, primitive in enumerate(primitives):
        kind = UsdGeom.Sphere if primitive.kind == "sphere" else UsdGeom.Cube
        shape = kind.Define(stage, f"{path}/Volume_{i}")
        if primitive.kind == "sphere":
            shape.CreateRadiusAttr(0.5)
            shape.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)]))
        else:
            shape.CreateSizeAttr(1.0)
            shape.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)]))
        matrix = Gf.Matrix4d().SetScale(Gf.Vec3d(*primitive.size))
        matrix *= Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), primitive.yaw_deg))
        matrix *= Gf.Matrix4d().SetTranslate(Gf.Vec3d(*primitive.centre))
        shape.AddTransformOp().Set(matrix)
        shape.GetPrim().SetCustomDataByKey("inpaint3d:inverted", primitive.inverted)
        _set_tint(shape)
    if hull is not None:
        _set_tint(define_mesh(stage, f"{path}/Hull", hull))


def _set_tint(shape: UsdGeom.Gprim) -> None:
    shape.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(1.0, 0.22, 0.42)]))
    shape.CreateDisplayOpacityAttr(Vt.FloatArray([0.35]))
