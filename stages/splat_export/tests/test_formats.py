"""What is written is read again, by readers written from the formats' specifications, to the formats' own precision."""

import gzip
import json
import struct

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdValidation, UsdVol

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.splat_export.cloud import SH_DEGREE_0, Y_DOWN, Y_UP, SplatCloud
from inpaint3d.stages.splat_export.export import write_splats
from inpaint3d.stages.splat_export.ply import PROPERTIES
from inpaint3d.stages.splat_export.spz import choose_fraction_bits, write_spz

ALL = ("ply", "spz", "glb", "usdc")


@pytest.fixture(scope="module")
def cloud():
    rng = np.random.default_rng(0)
    parts = rng.normal(size=(300, 3)), rng.normal(-4, 1, (300, 3)), 5 * rng.normal(size=(300, 4))
    made = SplatCloud(*parts, rng.normal(size=300) * 3, rng.random((300, 3)))
    return made.map(lambda array: array.astype(np.float32))


@pytest.fixture(scope="module")
def folder(cloud, tmp_path_factory):
    folder = tmp_path_factory.mktemp("splats")
    write_splats(folder, cloud, ALL, provenance={"radiance-field": "sha256:0"})
    return folder


def same_rotation(quaternion, truth, tolerance):
    """-q turns as q does."""
    np.testing.assert_allclose(np.abs((quaternion * truth).sum(1)), 1, atol=tolerance)


def test_the_metadata_tells_what_is_there(cloud, folder, tmp_path):
    metadata = write_splats(tmp_path, cloud, ("ply", "usdc"))
    assert {path.name for path in tmp_path.iterdir()} == {"splats.ply", "splats.usdc"} == set(metadata.files.values())
    assert metadata.splats == 300
    np.testing.assert_allclose(metadata.bounds_max, cloud.mean.max(0))


@pytest.mark.parametrize("one", ALL)
def test_equal_splats_give_equal_bytes(cloud, folder, tmp_path, one):
    write_splats(tmp_path, cloud, (one,), provenance={"radiance-field": "sha256:0"})
    assert (tmp_path / f"splats.{one}").read_bytes() == (folder / f"splats.{one}").read_bytes()


def test_ply_has_the_layout_of_the_reference_implementation(cloud, folder):
    header, _, body = (folder / "splats.ply").read_bytes().partition(b"end_header\n")
    lines = header.decode().splitlines()
    assert lines[:3] == ["ply", "format binary_little_endian 1.0", "element vertex 300"]
    assert [line.removeprefix("property float ") for line in lines[3:]] == list(PROPERTIES)
    rows = np.frombuffer(body, "<f4").reshape(300, len(PROPERTIES))
    column = dict(zip(PROPERTIES, rows.T, strict=True))
    np.testing.assert_allclose(column["y"], -cloud.mean[:, 2], atol=1e-6)
    np.testing.assert_allclose(column["z"], cloud.mean[:, 1], atol=1e-6)
    np.testing.assert_allclose(0.5 + SH_DEGREE_0 * column["f_dc_1"], cloud.rgb[:, 1], atol=1e-6)
    np.testing.assert_array_equal(column["opacity"], cloud.opacity)
    np.testing.assert_array_equal(rows[:, 10:13], cloud.log_scale)
    same_rotation(rows[:, 13:], cloud.turn(Y_DOWN).quaternion, 1e-6)


def read_spz(path):
    """As https://github.com/nianticlabs/spz says; values in units of their quantisation."""
    data = gzip.decompress(path.read_bytes())
    magic, version, count, degree, bits, flags, reserved = struct.unpack_from("<IIIBBBB", data)
    assert (magic, version, degree, flags, reserved) == (0x5053474E, 3, 0, 0, 0)
    assert len(data) == 16 + count * (9 + 1 + 3 + 3 + 4)
    body = np.frombuffer(data, np.uint8, offset=16)
    place, alpha, colour, scale, rotation = np.split(body, np.cumsum(np.array([9, 1, 3, 3]) * count))
    place = place.reshape(-1, 3).astype(np.int64) @ np.array([1, 256, 65536])
    place = np.where(place >= 2**23, place - 2**24, place).reshape(-1, 3) / 2.0**bits
    codes = rotation.copy().view("<u4")
    parts = np.zeros((count, 4))
    for row, code in enumerate(codes.tolist()):
        largest = code >> 30
        for part in reversed([part for part in range(4) if part != largest]):
            parts[row, part] = (code & 511) / 511 / np.sqrt(2) * (-1 if code & 512 else 1)
            code >>= 10
        parts[row, largest] = np.sqrt(max(0, 1 - np.square(parts[row]).sum()))
    return place, alpha / 255, colour.reshape(-1, 3) / 255, scale.reshape(-1, 3) / 16 - 10, np.roll(parts, 1, 1), bits


def test_spz_round_trip_is_within_its_quantisation(cloud, folder):
    turned = cloud.turn(Y_UP)
    place, alpha, colour, scale, rotation, bits = read_spz(folder / "splats.spz")
    assert bits >= 20
    np.testing.assert_allclose(place, turned.mean, atol=0.5 / 2**bits + 1e-7)
    np.testing.assert_allclose(alpha, turned.alpha, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(colour, 0.15 * turned.coefficients + 0.5, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(scale, turned.log_scale, atol=0.5 / 16 + 1e-6)
    # Each of three parts to half of 1 / (511 sqrt 2), the fourth made of them: cos of half the angle between.
    same_rotation(rotation, turned.quaternion, 3e-6)


@pytest.mark.parametrize("reach", [1e-3, 0.999999, 1.0, 1.5, 4.0, 1000.0, 2.0**23 - 1])
def test_places_of_any_reach_fit_into_three_bytes(reach):
    bits = choose_fraction_bits(np.array([[reach, -reach, 0]], np.float32))
    assert round(float(np.float32(reach)) * 2**bits) < 2**23
    assert bits == 23 or round(float(np.float32(reach)) * 2 ** (bits + 1)) >= 2**23 - 1


def test_a_place_too_far_for_spz_is_refused(cloud, tmp_path):
    far = cloud.map(lambda array: array.copy())
    far.mean[7, 1] = 1e8
    with pytest.raises(BadInputError, match="leave it out of formats"):
        write_spz(tmp_path / "splats.spz", far)


def test_glb_round_trip_is_exact(cloud, folder):
    data = (folder / "splats.glb").read_bytes()
    magic, version, length, text_length, kind = struct.unpack_from("<IIIII", data)
    assert (magic, version, length, kind) == (0x46546C67, 2, len(data), 0x4E4F534A)
    document, body = json.loads(data[20 : 20 + text_length]), data[28 + text_length :]
    (primitive,) = document["meshes"][0]["primitives"]
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    assert primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"

    def read(name):
        accessor = document["accessors"][primitive["attributes"][name]]
        view = document["bufferViews"][accessor["bufferView"]]
        dtype = {5126: "<f4", 5121: "u1"}[accessor["componentType"]]
        part = body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        return np.frombuffer(part, dtype).reshape(accessor["count"], -1)

    turned = cloud.turn(Y_UP)
    np.testing.assert_array_equal(read("POSITION"), turned.mean)
    np.testing.assert_array_equal(read("KHR_gaussian_splatting:ROTATION")[:, [3, 0, 1, 2]], turned.quaternion)
    np.testing.assert_array_equal(read("KHR_gaussian_splatting:SCALE"), np.exp(turned.log_scale))
    np.testing.assert_array_equal(read("KHR_gaussian_splatting:OPACITY")[:, 0], turned.alpha)
    np.testing.assert_array_equal(read("KHR_gaussian_splatting:SH_DEGREE_0_COEF_0"), turned.coefficients)
    assert read("COLOR_0").shape == (300, 4)


def test_usd_holds_the_splats_and_its_validators_find_no_error(cloud, folder):
    stage = Usd.Stage.Open(str(folder / "splats.usdc"))
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim().GetChild("Splats"))
    np.testing.assert_array_equal(np.array(field.GetPositionsAttr().Get()), cloud.mean)
    np.testing.assert_array_equal(np.array(field.GetScalesAttr().Get()), np.exp(cloud.log_scale))
    np.testing.assert_array_equal(np.array(field.GetOpacitiesAttr().Get()), cloud.alpha)
    rotations = [(q.GetReal(), *q.GetImaginary()) for q in field.GetOrientationsAttr().Get()]
    np.testing.assert_array_equal(np.array(rotations, np.float32), cloud.quaternion)
    coefficients = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get())
    np.testing.assert_array_equal(coefficients, cloud.coefficients)
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetRootLayer().customLayerData["inpaint3d:scale"] == "unknown"
    context = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    assert [error.GetMessage() for error in context.Validate(stage)] == []
