"""The capture's cameras in a USD stage: one that walks through the views, and one for each view."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence

import numpy as np
from pxr import Gf, Usd, UsdGeom

from inpaint3d.scene.cameras import Camera

FRAMES_PER_SECOND = 24.0
APERTURE_MM = 36.0  # of a full-frame camera; with it a photo's angle of view has the focal length that people know
_OPENCV_FROM_USD = np.diag([1.0, -1.0, -1.0])  # a USD camera looks along -z with y up


def write_cameras(
    stage: Usd.Stage, path: str, names: Sequence[str], cameras: Sequence[Camera], metres_per_unit: float
) -> None:
    """A time sample for each view on `path`/Walk, and a static camera for each under `path`/Views; all are guides.

    USD gives lenses in tenths of a scene unit, and tools turn them into millimetres by the stage's metersPerUnit: of
    36 mm there are 0.36 in a stage in metres.
    """
    tenths_per_mm = 0.01 / metres_per_unit
    UsdGeom.Scope.Define(stage, path).CreatePurposeAttr(UsdGeom.Tokens.guide)
    stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
    stage.SetFramesPerSecond(FRAMES_PER_SECOND)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(max(0, len(cameras) - 1))
    walk = UsdGeom.Camera.Define(stage, f"{path}/Walk")
    for i, camera in enumerate(cameras):
        _place(walk, camera, Usd.TimeCode(i), tenths_per_mm)
    UsdGeom.Scope.Define(stage, f"{path}/Views")
    for i, (name, camera) in enumerate(zip(names, cameras, strict=True)):
        # Names of pictures may be no USD identifiers, and two may become one: the number keeps them apart.
        prim = UsdGeom.Camera.Define(stage, f"{path}/Views/View_{i:04d}")
        prim.GetPrim().SetDisplayName(name)
        _place(prim, camera, Usd.TimeCode.Default(), tenths_per_mm)


def _place(prim: UsdGeom.Camera, camera: Camera, time: Usd.TimeCode, tenths_per_mm: float) -> None:
    aperture = APERTURE_MM * tenths_per_mm
    focal = camera.fx * aperture / camera.width
    vertical = focal / camera.fy
    prim.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    prim.CreateHorizontalApertureAttr().Set(aperture, time)
    prim.CreateVerticalApertureAttr().Set(camera.height * vertical, time)
    prim.CreateFocalLengthAttr().Set(focal, time)
    prim.CreateHorizontalApertureOffsetAttr().Set((camera.width / 2 - camera.cx) * aperture / camera.width, time)
    prim.CreateVerticalApertureOffsetAttr().Set((camera.cy - camera.height / 2) * vertical, time)
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.01, 1000.0))
    matrix = np.eye(4)
    matrix[:3, :3] = camera.rotation @ _OPENCV_FROM_USD
    matrix[:3, 3] = camera.centre
    _transform(prim).Set(Gf.Matrix4d(matrix.T), time)  # USD multiplies rows from the left


def _transform(prim: UsdGeom.Xformable) -> UsdGeom.XformOp:
    operations = prim.GetOrderedXformOps()
    return operations[0] if operations else prim.AddTransformOp()
