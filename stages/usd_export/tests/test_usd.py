import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.usd_export.layer import Content, Scene, write_layer
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.package import ALIGNMENT, write_package
from inpaint3d.stages.usd_export.validation import validate

TRIANGLE = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), np.array([[0, 1, 2]]))
UV = np.array([[[0.1, 0.1], [0.9, 0.1], [0.1, 0.9]]], np.float32)


def camera(i: int = 0) -> Camera:
    return Camera(50 + i, 55, 33, 22, 64, 48, look_at((1 + 0.1 * i, -2, 0.7), (0, 0, 0)))


def written(folder: Path, **changes) -> Path:
    contents = [Content(name, TRIANGLE, UV, f"textures/{name}.png") for name in ("inpainted", "original")]
    for content in contents:
        write_png(folder / content.texture, np.full((8, 8, 3), 0.5, np.float32))
    values = {
        "contents": contents, "names": ["a b", "0ä"], "cameras": [camera(0), camera(1)],
        "primitives": [], "hull": None, "metres_per_unit": 0.5,
    } | changes  # fmt: skip
    write_layer(folder / "scene.usdc", Scene(**values))
    return folder / "scene.usdc"


def packed(folder: Path) -> Path:
    files = ["scene.usdc", "textures/inpainted.png", "textures/original.png"]
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
    variants = stage.GetDefaultPrim().GetVariantSet("content")
    assert (variants.GetVariantNames(), variants.GetVariantSelection()) == (["inpainted", "original"], "inpainted")
    texture = stage.GetPrimAtPath("/Scene/Surface/Material/Texture").GetAttribute("inputs:file")
    assert texture.Get().path == "textures/inpainted.png"
    variants.SetVariantSelection("original")
    assert texture.Get().path == "textures/original.png"


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
