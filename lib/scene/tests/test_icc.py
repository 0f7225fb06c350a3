"""Profiles are applied; the right colours are computed from the chromaticities of the primaries, not by the reader."""

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.icc import read_profile
from inpaint3d.scene.image_io import read_header, read_image, read_stored
from tests.colour_profiles import (
    ADOBE_RGB,
    DISPLAY_P3,
    GAMMA_22,
    SRGB,
    SRGB_CURVE,
    grey_profile,
    make_profile,
    matrix_profile,
    table_curve,
)

RED = (230, 40, 40)
D65 = np.array([0.3127, 0.329, 0.3583])


def xyz_from_chromaticities(*xy: tuple[float, float]) -> np.ndarray:
    """XYZ of linear RGB [3, 3] whose white is D65 with Y = 1."""
    primaries = np.array([[x, y, 1 - x - y] for x, y in xy]).T
    return primaries * np.linalg.solve(primaries, D65 / D65[1])


XYZ_FROM = {
    "srgb": xyz_from_chromaticities((0.64, 0.33), (0.30, 0.60), (0.15, 0.06)),
    "p3": xyz_from_chromaticities((0.68, 0.32), (0.265, 0.69), (0.15, 0.06)),
    "adobe": xyz_from_chromaticities((0.64, 0.33), (0.21, 0.71), (0.15, 0.06)),
}


def expected(space: str, decode) -> np.ndarray:
    light = np.linalg.solve(XYZ_FROM["srgb"], XYZ_FROM[space] @ decode(np.array(RED) / 255)).clip(0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def srgb_light(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def write(path, pixels, profile, kind="uint8"):
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, kind)
    spec.attribute("ICCProfile", oiio.TypeDesc(f"uint8[{len(profile)}]"), np.frombuffer(profile, np.uint8))
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()
    return path


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize(
    ("space", "profile", "decode"),
    [
        ("p3", matrix_profile(DISPLAY_P3, SRGB_CURVE), srgb_light),
        ("adobe", matrix_profile(ADOBE_RGB, GAMMA_22), lambda x: x**2.19921875),
        ("adobe", matrix_profile(ADOBE_RGB, table_curve(2.19921875)), lambda x: x**2.19921875),
    ],
)
def test_colours_are_those_that_the_profile_means(tmp_path, suffix, space, profile, decode):
    path = write(tmp_path / f"a{suffix}", np.full((5, 7, 3), RED, np.uint8), profile)
    stored = read_stored(path)
    assert stored.dtype == np.uint8
    np.testing.assert_allclose(stored[2, 3], expected(space, decode), atol=1.5)
    deep = write(tmp_path / "deep.tif", np.full((5, 7, 3), RED, np.uint16) * 257, profile, "uint16")
    np.testing.assert_allclose(255 * read_image(deep)[2, 3], expected(space, decode), atol=1)


def test_an_srgb_profile_changes_nothing(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (9, 11, 3), np.uint8)
    path = write(tmp_path / "a.png", pixels, matrix_profile(SRGB, SRGB_CURVE))
    assert read_header(path).profile is None
    np.testing.assert_array_equal(read_stored(path), pixels)


def test_grey_has_one_curve(tmp_path):
    path = write(tmp_path / "g.png", np.full((4, 4, 1), 128, np.uint8), grey_profile(table_curve(1.0, 2)))
    # Linear light of 0.502 is 0.737 in sRGB.
    np.testing.assert_allclose(read_image(path)[0, 0], 0.737, atol=1 / 255)


@pytest.mark.parametrize(
    ("profile", "message"),
    [
        (make_profile(b"RGB ", {b"A2B0": b"mft2" + bytes(60)}), "tables alone"),
        (matrix_profile(SRGB, b"what\0\0\0\0"), "curve of type"),
        (matrix_profile(SRGB, SRGB_CURVE)[:200], "colour profile"),
    ],
)
def test_what_cannot_be_applied_is_refused_by_name(tmp_path, profile, message):
    path = write(tmp_path / "a.png", np.full((4, 4, 3), 9, np.uint8), matrix_profile(SRGB, SRGB_CURVE))
    with pytest.raises(ValueError):
        read_profile(profile)
    path = write(tmp_path / "a.tif", np.full((4, 4, 3), 9, np.uint8), profile)
    with pytest.raises(BadInputError, match=rf"a\.tif.*{message}"):
        read_image(path)
