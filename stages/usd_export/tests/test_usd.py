import struct
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics

from inpaint3d.contracts.errors import NonFiniteError
from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.usd_export.layer import Content, Scene, write_layers
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.package import ALIGNMENT, write_package
from inpaint3d.stages.usd_export.soundness import BrokenStageError, refuse_broken
from inpaint3d.stages.usd_export.validation import validate

TRIANGLE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), np.array([[0, 1, 2]]))
TETRAHEDRON = Mesh(
    np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
)
UV = np.array([[[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]], np.float32)


def camera(i: int = 0) -> Camera:
    return Camera(50 + i, 55, 33, 22, 64, 48, look_at((1 + 0.1 * i, -2, 0.7), (0, 0, 0)))


def contents_of(folder: Path) -> list[Content]:
    contents = [
        Content(name, TRIANGLE, UV, f"textures/{name}.png", np.ones(1, np.float32))
        for name in ("inpainted", "original")
    ]
    for content in contents:
        write_png(folder / content.texture, np.full((8, 8, 3), 0.5, np.float32))
    return contents


def written(folder: Path, **changes) -> Path:
    values = {
        "contents": contents_of(folder), "names": ["a b", "0ä"], "cameras": [camera(0), camera(1)],
        "primitives": [], "hull": None, "points": synthetic_scene(points=5).points, "metres_per_unit": 0.5,
    } | changes  # fmt: skip
    write_layers(folder / "scene.usdc", Scene(**values))
    return folder / "scene.usdc"


def packed(folder: Path) -> Path:
    files = ["scene.usdc", "inpainted.usdc", "original.usdc", "textures/inpainted.png", "textures/original.png"]
    write_package(folder / "scene.usdz", [(name, folder / name) for name in files])
    return folder / "scene.usdz"


@pytest.fixture
def folder(tmp_path) -> Path:
    (tmp_path / "textures").mkdir()
    return tmp_path


def test_layer_and_package_pass_every_validator(folder):
    primitives = [
        Primitive(kind="sphere", centre=(0, 0, 1), size=(0.4, 0.4, 0.4)),
        Primitive(kind="box", centre=(1, 0, 0), size=(1, 2, 3), yaw_deg=30),
    ]
    written(folder, primitives=primitives, hull=TRIANGLE)
    packed(folder)
    assert validate(folder, ["scene.usdc", "scene.usdz"]) == []


def test_bodies_collide_with_convex_pieces_that_nobody_sees(folder):
    """Each variant has its own; the validators of physics find nothing wrong with them."""
    pieces = [TETRAHEDRON, Mesh(TETRAHEDRON.vertices + 1, TETRAHEDRON.triangles)]
    contents = [replace(content, pieces=pieces) for content in contents_of(folder)]
    stage = Usd.Stage.Open(str(written(folder, contents=contents)))
    holder = UsdGeom.Imageable(stage.GetPrimAtPath("/Scene/Collision"))
    assert (holder.ComputePurpose(), holder.ComputeVisibility()) == ("proxy", "invisible")
    there = list(stage.GetPrimAtPath("/Scene/Collision").GetChildren())
    assert [UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get() for prim in there] == ["convexHull"] * 2
    assert all(prim.HasAPI(UsdPhysics.CollisionAPI) for prim in there)
    assert UsdGeom.Imageable(stage.GetPrimAtPath("/Scene/Surface")).ComputePurpose() == "default"
    packed(folder)
    assert validate(folder, ["scene.usdc", "scene.usdz"]) == []
    refuse_broken(folder, ["scene.usdc"])


def test_validators_are_really_run(folder):
    stage = Usd.Stage.CreateNew(str(folder / "bad.usda"))
    UsdGeom.Mesh.Define(stage, "/Loose")
    stage.GetRootLayer().Save()
    findings = validate(folder, ["bad.usda"])
    assert any("default" in f.message.lower() for f in findings)
    assert not any(str(folder) in f.message for f in findings)


def test_a_scale_that_nothing_tells_is_unknown(folder):
    """The validators ask for a length; that it means nothing is said beside it."""
    layer = written(folder, metres_per_unit=None)
    assert Usd.Stage.Open(str(layer)).GetRootLayer().customLayerData == {"inpaint3d:scale": "unknown"}
    assert validate(folder, ["scene.usdc"]) == []


def test_stage_says_what_a_production_asks(folder):
    stage = Usd.Stage.Open(str(written(folder)))
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    assert UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.5
    assert stage.GetRootLayer().customLayerData == {"inpaint3d:scale": "known"}
    model = Usd.ModelAPI(stage.GetDefaultPrim())
    assert (model.GetAssetName(), model.GetAssetVersion()) == ("scene", "0.1.0")
    variants = stage.GetDefaultPrim().GetVariantSet("content")
    assert (variants.GetVariantNames(), variants.GetVariantSelection()) == (["inpainted", "original"], "inpainted")
    texture = stage.GetPrimAtPath("/Scene/Surface/Material/Texture").GetAttribute("inputs:file")
    assert texture.Get().path == "textures/inpainted.png"
    variants.SetVariantSelection("original")
    assert texture.Get().path == "textures/original.png"


def test_the_mesh_has_unit_normals_and_says_what_was_filled(folder):
    stage = Usd.Stage.Open(str(written(folder)))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface"))
    normals = np.array(mesh.GetNormalsAttr().Get())
    np.testing.assert_allclose(normals, TRIANGLE.normals().repeat(3, 0), atol=1e-6)
    assert mesh.GetNormalsInterpolation() == "vertex"
    assert list(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("inpainted").Get()) == [1.0]
    (subset,) = UsdGeom.Subset.GetAllGeomSubsets(mesh)
    assert (subset.GetPrim().GetName(), list(subset.GetIndicesAttr().Get())) == ("Inpainted", [0])


def test_provenance_is_in_the_layer(folder):
    layer = written(folder, provenance={"posed-capture": "sha256:ab", "up": "gravity"})
    stage = Usd.Stage.Open(str(layer))
    told = stage.GetRootLayer().customLayerData
    assert (told["inpaint3d:posed-capture"], told["inpaint3d:up"]) == ("sha256:ab", "gravity")


def test_sparse_points_and_cameras_are_guides(folder):
    stage = Usd.Stage.Open(str(written(folder)))
    points = UsdGeom.Points(stage.GetPrimAtPath("/Scene/SparsePoints"))
    assert len(points.GetPointsAttr().Get()) == len(points.GetDisplayColorAttr().Get()) == 5
    for path in ("/Scene/SparsePoints", "/Scene/Cameras/Walk", "/Scene/Cameras/Views/View_0000"):
        assert UsdGeom.Imageable(stage.GetPrimAtPath(path)).ComputePurpose() == UsdGeom.Tokens.guide


@pytest.mark.parametrize("metres_per_unit", [None, 0.01, 0.5, 1.0])
def test_a_50_mm_lens_reads_as_one_in_any_units(folder, metres_per_unit):
    """Tools take USD's lenses for tenths of a scene unit: in millimetres, times 100 by the stage's metres."""
    lens = Camera(50 / 36 * 640, 50 / 36 * 640, 320, 240, 640, 480, camera().world_from_cam)
    stage = Usd.Stage.Open(str(written(folder, cameras=[lens, lens], metres_per_unit=metres_per_unit)))
    prim = UsdGeom.Camera(stage.GetPrimAtPath("/Scene/Cameras/Views/View_0000"))
    to_mm = 100 * UsdGeom.GetStageMetersPerUnit(stage)
    assert prim.GetFocalLengthAttr().Get() * to_mm == pytest.approx(50)
    assert prim.GetHorizontalApertureAttr().Get() * to_mm == pytest.approx(36)
    assert prim.GetVerticalApertureAttr().Get() * to_mm == pytest.approx(27)


def broken(folder: Path, change) -> None:
    written(folder)
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    variants = stage.GetDefaultPrim().GetVariantSet("content")
    variants.SetVariantSelection("original")  # not the one that shows
    with variants.GetVariantEditContext():
        change(stage)
    variants.SetVariantSelection("inpainted")
    stage.GetRootLayer().Save()
    refuse_broken(folder, ["scene.usdc"])


def set_texture(path: str):
    def change(stage: Usd.Stage) -> None:
        stage.GetPrimAtPath("/Scene/Surface/Material/Texture").GetAttribute("inputs:file").Set(Sdf.AssetPath(path))

    return change


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_stage_with_a_number_that_is_not_finite_is_refused(folder, value):
    def change(stage: Usd.Stage) -> None:
        points = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface")).GetPointsAttr().Get())
        points[1, 2] = value
        UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface")).GetPointsAttr().Set(points)

    with pytest.raises(NonFiniteError, match=r"original.*/Scene/Surface.points: 1 numbers are not finite"):
        broken(folder, change)


def test_a_stage_with_a_wrong_extent_is_refused(folder):
    def change(stage: Usd.Stage) -> None:
        UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface")).GetExtentAttr().Set([(0, 0, 0), (9, 9, 9)])

    with pytest.raises(BrokenStageError, match="the extent is"):
        broken(folder, change)


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("textures/nowhere.png", "there is no file textures/nowhere.png"),
        ("/etc/hostname", "leads out of the scene's folder"),
        ("../other.png", "leads out of the scene's folder"),
        ("https://example.org/a.png", "leads out of the scene's folder"),
    ],
)
def test_a_texture_that_is_missing_or_elsewhere_is_refused(folder, path, said):
    with pytest.raises(BrokenStageError, match=said):
        broken(folder, set_texture(path))


def test_a_layer_that_is_missing_is_refused(folder):
    written(folder)
    (folder / "original.usdc").unlink()
    with pytest.raises(BrokenStageError, match=r"\(original\).*a layer does not load.*original\.usdc"):
        refuse_broken(folder, ["scene.usdc"])


def test_a_scene_opens_without_its_heavy_part(folder):
    """Contents are payloads: cameras, points and mask are there before any mesh is loaded."""
    layer = written(folder, hull=TRIANGLE)
    light = Usd.Stage.Open(str(layer), Usd.Stage.LoadNone)
    assert light.GetPrimAtPath("/Scene/Cameras/Walk")
    assert light.GetPrimAtPath("/Scene/Mask/Hull")
    assert not light.GetPrimAtPath("/Scene/Surface")
    light.Load()
    assert light.GetPrimAtPath("/Scene/Surface")


def test_a_sound_stage_and_its_package_are_not_refused(folder):
    written(folder)
    packed(folder)
    refuse_broken(folder, ["scene.usdc", "scene.usdz"])


def test_a_cameras_pixels_are_where_ours_are(folder):
    stage = Usd.Stage.Open(str(written(folder)))
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3))
    for path, time, ours in (
        ("/Scene/Cameras/Views/View_0001", Usd.TimeCode.Default(), camera(1)),
        ("/Scene/Cameras/Walk", Usd.TimeCode(0), camera(0)),
        ("/Scene/Cameras/Walk", Usd.TimeCode(1), camera(1)),
    ):
        frustum = UsdGeom.Camera(stage.GetPrimAtPath(path)).GetCamera(time).frustum
        seen = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
        clip = np.array([seen.Transform(Gf.Vec3d(*p)) for p in points])
        xy = np.stack([(clip[:, 0] + 1) / 2 * ours.width, (1 - clip[:, 1]) / 2 * ours.height], 1)
        # USD stores apertures as float32
        np.testing.assert_allclose(xy, ours.project(points)[0], atol=1e-3)


def test_the_mask_is_a_guide_of_its_size_and_place(folder):
    box = Primitive(kind="box", centre=(1, 2, 3), size=(2, 4, 6), yaw_deg=90, inverted=True)
    stage = Usd.Stage.Open(str(written(folder, primitives=[box])))
    prim = stage.GetPrimAtPath("/Scene/Mask/Volume_0")
    assert UsdGeom.Imageable(prim).ComputePurpose() == UsdGeom.Tokens.guide
    assert prim.GetCustomDataByKey("inpaint3d:inverted") is True
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), [UsdGeom.Tokens.guide])
    extent = cache.ComputeWorldBound(prim).ComputeAlignedRange()
    np.testing.assert_allclose(extent.GetMin(), (1 - 2, 2 - 1, 0), atol=1e-6)  # turned by a quarter: x and y swap
    np.testing.assert_allclose(extent.GetMax(), (1 + 2, 2 + 1, 6), atol=1e-6)


def test_package_data_is_aligned_stored_and_timeless(folder):
    written(folder)
    path = packed(folder)
    data = path.read_bytes()
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist()[0] == "scene.usdc"
        for info in archive.infolist():
            name, extra = struct.unpack_from("<HH", data, info.header_offset + 26)
            start = info.header_offset + 30 + name + extra
            assert start % ALIGNMENT == 0
            assert info.compress_type == zipfile.ZIP_STORED
            assert data[start : start + info.file_size] == (folder / info.filename).read_bytes()
            assert info.date_time == (1980, 1, 1, 0, 0, 0)


def test_equal_scenes_give_equal_bytes(folder, tmp_path):
    written(folder)
    first = packed(folder).read_bytes()
    again = tmp_path / "again"
    (again / "textures").mkdir(parents=True)
    written(again)
    assert packed(again).read_bytes() == first
