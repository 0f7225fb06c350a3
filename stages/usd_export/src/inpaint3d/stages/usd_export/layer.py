"""The USD layers: one for each content, its mesh with a texture; and the scene with a variant that loads each as a
payload, cameras, sparse points, and the mask as a guide.
"""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints
from inpaint3d.stages.usd_export.camera_prims import write_cameras
from inpaint3d.stages.usd_export.guide_prims import write_mask, write_points
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.mesh_prims import define_mesh, write_collision

ROOT = "/Scene"
VARIANT_SET = "content"
ASSET_VERSION = "0.1.0"


@dataclass(frozen=True, eq=False)
class Content:
    """One variant: its mesh, texture coordinates [t, 3, 2], the texture's path relative to the layer, and the convex
    pieces that bodies collide with.

    filled: of the pictures that show a triangle, the share in which it lies under the mask, [t].
    """

    name: str
    mesh: Mesh
    coordinates: NDArray[np.float32]
    texture: str
    filled: NDArray[np.float32]
    pieces: Sequence[Mesh] = ()


@dataclass(frozen=True, eq=False)
class Scene:
    """All that the layer holds. The first content is the one that shows.

    provenance: what the scene was made of, name to digest or words; it becomes customLayerData.
    """

    contents: Sequence[Content]
    names: Sequence[str]
    cameras: Sequence[Camera]
    primitives: Sequence[Primitive]
    hull: Mesh | None
    points: SparsePoints | None
    metres_per_unit: float | None
    provenance: Mapping[str, str] = field(default_factory=dict)


def name_payload(content: Content) -> str:
    """The file of a content's own layer, beside the scene's."""
    return f"{content.name}.usdc"


def write_layers(path: Path, scene: Scene) -> None:
    """Write the scene as a binary layer, its contents beside it; equal scenes give equal bytes."""
    metres_per_unit = scene.metres_per_unit or 1.0
    for content in scene.contents:
        _write_content(path.with_name(name_payload(content)), content, metres_per_unit)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    # USD has no word for it, and its validators ask for a length.
    known = "unknown" if scene.metres_per_unit is None else "known"
    told = {f"inpaint3d:{name}": value for name, value in sorted(scene.provenance.items())}
    stage.GetRootLayer().customLayerData = {"inpaint3d:scale": known} | told
    root = UsdGeom.Xform.Define(stage, ROOT).GetPrim()
    stage.SetDefaultPrim(root)
    model = Usd.ModelAPI(root)
    model.SetKind("component")
    model.SetAssetName("scene")
    model.SetAssetVersion(ASSET_VERSION)
    variants = root.GetVariantSets().AddVariantSet(VARIANT_SET)
    for content in scene.contents:
        variants.AddVariant(content.name)
        variants.SetVariantSelection(content.name)
        with variants.GetVariantEditContext():
            root.GetPayloads().AddPayload(f"./{name_payload(content)}")
    variants.SetVariantSelection(scene.contents[0].name)
    write_cameras(stage, f"{ROOT}/Cameras", scene.names, scene.cameras, metres_per_unit)
    if scene.points is not None and len(scene.points):
        write_points(stage, f"{ROOT}/SparsePoints", scene.points)
    write_mask(stage, f"{ROOT}/Mask", scene.primitives, scene.hull)
    stage.GetRootLayer().Save()


def _write_content(path: Path, content: Content, metres_per_unit: float) -> None:
    """A layer whose default prim has the surface, and what bodies collide with."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, ROOT).GetPrim())
    _write_mesh(stage, content)
    write_collision(stage, f"{ROOT}/Collision", content.pieces)
    stage.GetRootLayer().Save()


def _write_mesh(stage: Usd.Stage, content: Content) -> None:
    mesh = define_mesh(stage, f"{ROOT}/Surface", content.mesh)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(content.mesh.vertex_normals().astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    st.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(content.coordinates.reshape(-1, 2))))
    _mark_filled(mesh, content.filled)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(_write_material(stage, content.texture))


def _mark_filled(mesh: UsdGeom.Mesh, filled: NDArray[np.float32]) -> None:
    """A primvar that says how much of a triangle was filled, and a subset to select those that mostly were."""
    api = UsdGeom.PrimvarsAPI(mesh)
    share = api.CreatePrimvar("inpainted", Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.uniform)
    share.Set(Vt.FloatArray.FromNumpy(filled))
    chosen = np.flatnonzero(filled > 0.5).astype(np.int32)
    subset = UsdGeom.Subset.Define(mesh.GetPrim().GetStage(), f"{mesh.GetPath()}/Inpainted")
    subset.CreateElementTypeAttr(UsdGeom.Tokens.face)
    subset.CreateFamilyNameAttr("region")
    subset.CreateIndicesAttr(Vt.IntArray.FromNumpy(chosen))
    UsdGeom.Subset.SetFamilyType(mesh, "region", UsdGeom.Tokens.nonOverlapping)


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
