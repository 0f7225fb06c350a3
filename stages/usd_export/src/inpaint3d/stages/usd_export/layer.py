"""The USD layer: mesh with texture in a variant for each content, cameras, and the mask as a guide."""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.scene.cameras import Camera
from inpaint3d.stages.usd_export.mesh import Mesh

ROOT = "/Scene"
VARIANT_SET = "content"
FRAMES_PER_SECOND = 24.0
APERTURE_MM = 36.0  # of a full-frame camera; only its ratio to the focal length matters
_OPENCV_FROM_USD = np.diag([1.0, -1.0, -1.0])  # a USD camera looks along -z with y up


@dataclass(frozen=True, eq=False)
class Content:
    """One variant: its mesh, texture coordinates [t, 3, 2] and the texture's path relative to the layer."""

    name: str
    mesh: Mesh
    coordinates: NDArray[np.float32]
    texture: str


@dataclass(frozen=True, eq=False)
class Scene:
    """All that the layer holds. The first content is the one that shows."""

    contents: Sequence[Content]
    names: Sequence[str]
    cameras: Sequence[Camera]
    primitives: Sequence[Primitive]
    hull: Mesh | None
    metres_per_unit: float | None


def write_layer(path: Path, scene: Scene) -> None:
    """Write the scene as a binary layer; equal scenes give equal bytes."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, scene.metres_per_unit or 1.0)
    # USD has no word for it, and its validators ask for a length.
    known = "unknown" if scene.metres_per_unit is None else "known"
    stage.GetRootLayer().customLayerData = {"inpaint3d:scale": known}
    root = UsdGeom.Xform.Define(stage, ROOT).GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind("component")
    variants = root.GetVariantSets().AddVariantSet(VARIANT_SET)
    for content in scene.contents:
        variants.AddVariant(content.name)
        variants.SetVariantSelection(content.name)
        with variants.GetVariantEditContext():
            _write_mesh(stage, content)
    variants.SetVariantSelection(scene.contents[0].name)
    _write_cameras(stage, scene)
    _write_mask(stage, scene)
    stage.GetRootLayer().Save()


def _write_mesh(stage: Usd.Stage, content: Content) -> None:
    mesh = UsdGeom.Mesh.Define(stage, f"{ROOT}/Surface")
    points = content.mesh.vertices.astype(np.float32)
    triangles = content.mesh.triangles.astype(np.int32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(_compute_extent(points))
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(content.coordinates.reshape(-1, 2))))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(_write_material(stage, content.texture))


def _write_material(stage: Usd.Stage, texture: str) -> UsdShade.Material:
    """A lit-from-within preview surface: the photos' light is already in the texture."""
    place = f"{ROOT}/Surface/Material"
    material = UsdShade.Material.Define(stage, place)
    reader = UsdShade.Shader.Define(stage, f"{place}/Coordinates")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    sampler = UsdShade.Shader.Define(stage, f"{place}/Texture")
    sampler.CreateIdAttr("UsdUVTexture")
    sampler.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(Sdf.AssetPath(texture))
    sampler.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("sRGB")
    for wrap in ("wrapS", "wrapT"):
        sampler.CreateInput(wrap, Sdf.ValueTypeNames.Token).Set("clamp")
    coordinates = reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    sampler.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(coordinates)
    colour = sampler.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface = UsdShade.Shader.Define(stage, f"{place}/Preview")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0, 0, 0))
    surface.CreateInput("emissiveColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(colour)
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    surface.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0, 0, 0))
    surface.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
    material.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", Sdf.ValueTypeNames.Token))
    return material


def _write_cameras(stage: Usd.Stage, scene: Scene) -> None:
    """One camera that walks through the views, a frame each, and one camera for each view."""
    UsdGeom.Scope.Define(stage, f"{ROOT}/Cameras")
    stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
    stage.SetFramesPerSecond(FRAMES_PER_SECOND)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(max(0, len(scene.cameras) - 1))
    walk = UsdGeom.Camera.Define(stage, f"{ROOT}/Cameras/Walk")
    for i, camera in enumerate(scene.cameras):
        _place_camera(walk, camera, Usd.TimeCode(i))
    UsdGeom.Scope.Define(stage, f"{ROOT}/Cameras/Views")
    for i, (name, camera) in enumerate(zip(scene.names, scene.cameras, strict=True)):
        # Names of pictures may be no USD identifiers, and two may become one: the number keeps them apart.
        prim = UsdGeom.Camera.Define(stage, f"{ROOT}/Cameras/Views/View_{i:04d}")
        prim.GetPrim().SetDisplayName(name)
        _place_camera(prim, camera, Usd.TimeCode.Default())


def _place_camera(prim: UsdGeom.Camera, camera: Camera, time: Usd.TimeCode) -> None:
    focal = camera.fx * APERTURE_MM / camera.width
    vertical = focal / camera.fy
    prim.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    prim.CreateHorizontalApertureAttr().Set(APERTURE_MM, time)
    prim.CreateVerticalApertureAttr().Set(camera.height * vertical, time)
    prim.CreateFocalLengthAttr().Set(focal, time)
    prim.CreateHorizontalApertureOffsetAttr().Set((camera.width / 2 - camera.cx) * APERTURE_MM / camera.width, time)
    prim.CreateVerticalApertureOffsetAttr().Set((camera.cy - camera.height / 2) * vertical, time)
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.01, 1000.0))
    matrix = np.eye(4)
    matrix[:3, :3] = camera.rotation @ _OPENCV_FROM_USD
    matrix[:3, 3] = camera.centre
    _transform(prim).Set(Gf.Matrix4d(matrix.T), time)  # USD multiplies rows from the left


def _transform(prim: UsdGeom.Xformable) -> UsdGeom.XformOp:
    operations = prim.GetOrderedXformOps()
    return operations[0] if operations else prim.AddTransformOp()


def _write_mask(stage: Usd.Stage, scene: Scene) -> None:
    """The mask's volumes, of purpose `guide`: shown when asked for, never rendered."""
    if not scene.primitives and scene.hull is None:
        return
    holder = UsdGeom.Xform.Define(stage, f"{ROOT}/Mask")
    holder.CreatePurposeAttr(UsdGeom.Tokens.guide)
    for i, primitive in enumerate(scene.primitives):
        kind = UsdGeom.Sphere if primitive.kind == "sphere" else UsdGeom.Cube
        shape = kind.Define(stage, f"{ROOT}/Mask/Volume_{i}")
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
    if scene.hull is not None:
        hull = UsdGeom.Mesh.Define(stage, f"{ROOT}/Mask/Hull")
        points = scene.hull.vertices.astype(np.float32)
        triangles = scene.hull.triangles.astype(np.int32)
        hull.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
        hull.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(triangles), 3, np.int32)))
        hull.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(triangles.ravel()))
        hull.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        hull.CreateExtentAttr(_compute_extent(points))
        _set_tint(hull)


def _set_tint(shape: UsdGeom.Gprim) -> None:
    shape.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(1.0, 0.22, 0.42)]))
    shape.CreateDisplayOpacityAttr(Vt.FloatArray([0.35]))


def _compute_extent(points: NDArray[np.float32]) -> Vt.Vec3fArray:
    return Vt.Vec3fArray([Gf.Vec3f(*map(float, points.min(0))), Gf.Vec3f(*map(float, points.max(0)))])
