import struct
import zlib
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES, UNREADABLE_SUFFIXES
from inpaint3d.scene.colour import from_bytes, srgb_from_linear
from inpaint3d.scene.image_io import (
    read_header,
    read_image,
    read_mask,
    read_opaque,
    read_stored,
    turn_upright,
    write_mask,
    write_png,
)
from inpaint3d.scene.map_io import read_exr, write_exr

IMAGE = np.random.default_rng(0).random((12, 20, 3)).astype(np.float32)


def write(path: Path, pixels: np.ndarray, kind: str, **attributes: object) -> Path:
    """A picture as other programs write it."""
    pixels = pixels if pixels.ndim == 3 else pixels[..., None]
    h, w, c = pixels.shape
    spec = oiio.ImageSpec(w, h, c, kind)
    for name, value in attributes.items():
        spec.attribute(name, value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(pixels, np.float32))
    output.close()
    return path


def test_a_png_comes_back_within_half_a_level(tmp_path):
    write_png(tmp_path / "a.png", IMAGE)
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), IMAGE, atol=0.5 / 255 + 1e-6)
    header = read_header(tmp_path / "a.png")
    assert (header.width, header.height, header.channels, header.bits, header.format) == (20, 12, 3, 8, "png")


def test_sixteen_bit_keeps_more_than_eight(tmp_path):
    path = write(tmp_path / "a.tif", IMAGE, "uint16")
    np.testing.assert_allclose(read_image(path), IMAGE, atol=1 / 65535)
    assert read_header(path).bits == 16


@pytest.mark.parametrize("suffix", [".exr", ".hdr"])
def test_linear_float_files_are_encoded(tmp_path, suffix):
    path = write(tmp_path / f"a{suffix}", IMAGE, "float")
    # Radiance's shared exponent keeps 8 bits of the brightest channel.
    tolerance = 1e-6 if suffix == ".exr" else 0.05
    np.testing.assert_allclose(read_image(path), srgb_from_linear(IMAGE), atol=tolerance)


def test_light_beyond_one_is_clipped(tmp_path):
    light = np.full((2, 2, 3), 0.5)
    light[0] = 5
    path = write(tmp_path / "a.exr", light, "float")
    np.testing.assert_allclose(read_image(path)[0], 1, rtol=1e-6)
    assert read_image(path)[1].max() < 0.8


@pytest.mark.parametrize("channels", [1, 3, 4])
@pytest.mark.parametrize(("suffix", "orientation"), [(".png", 1), (".jpg", 1), (".jpg", 6)])
def test_eight_bits_are_what_openimageio_makes_of_them(tmp_path, suffix, orientation, channels):
    if suffix == ".jpg" and channels == 4:
        channels = 3  # it has no alpha
    pixels = np.random.default_rng(1).random((16, 20, channels)).astype(np.float32)
    path = write(tmp_path / f"a{suffix}", pixels, "uint8", Orientation=orientation)
    stored, image = read_stored(path), read_image(path)
    assert stored.dtype == np.uint8
    np.testing.assert_array_equal(image, from_bytes(stored))
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)
    theirs = oiio.ImageBufAlgo.reorient(oiio.ImageBuf(str(path), 0, 0, hint)).get_pixels(oiio.FLOAT)
    np.testing.assert_array_equal(image, np.broadcast_to(theirs[..., :3], image.shape))


@pytest.mark.parametrize(("suffix", "kind"), [(".tif", "uint16"), (".exr", "half")])
def test_more_than_eight_bits_are_not_cut_down(tmp_path, suffix, kind):
    path = write(tmp_path / f"a{suffix}", IMAGE, kind)
    assert read_stored(path).dtype == np.float32
    np.testing.assert_array_equal(read_stored(path), read_image(path))


@pytest.mark.parametrize("orientation", [3, 6, 8])
def test_exif_orientation_is_applied(tmp_path, orientation):
    picture = np.zeros((16, 32, 3), np.float32)
    picture[:8, :16] = 1  # white at the stored top left
    path = write(tmp_path / "a.jpg", picture, "uint8", Orientation=orientation)
    upright = read_image(path)
    # 3: half a turn; 6: the stored top left is shown at the top right; 8: at the bottom left.
    corner = {3: upright[-1, -1], 6: upright[0, -1], 8: upright[-1, 0]}[orientation]
    assert corner.min() > 0.9
    assert upright.shape == ((16, 32, 3) if orientation == 3 else (32, 16, 3))
    assert read_header(path).upright_size == upright.shape[1::-1]


def test_grey_is_repeated_and_alpha_does_not_darken(tmp_path):
    grey = read_image(write(tmp_path / "g.png", IMAGE[..., 0], "uint8"))
    np.testing.assert_array_equal(grey[..., 0], grey[..., 2])
    half = np.concatenate([IMAGE, np.full((12, 20, 1), 0.5)], -1)
    write_png(tmp_path / "a.png", half)
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), IMAGE, atol=0.5 / 255 + 1e-6)


def test_masks_are_cut_above_the_middle(tmp_path):
    write_png(tmp_path / "m.png", np.array([[0, 127, 128, 255]], np.uint8))
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), [[False, False, True, True]])
    mask = IMAGE[..., 0] > 0.3
    write_mask(tmp_path / "n.png", mask)
    np.testing.assert_array_equal(read_mask(tmp_path / "n.png", (20, 12)), mask)
    with pytest.raises(BadInputError, match=r"n\.png is 20x12 but its image is 20x13"):
        read_mask(tmp_path / "n.png", (20, 13))


def test_a_cut_out_is_a_mask_by_its_alpha(tmp_path):
    alpha = (IMAGE[..., :1] > 0.5).astype(np.float32)
    write_png(tmp_path / "c.png", np.concatenate([np.ones((12, 20, 3)), alpha], -1))
    np.testing.assert_array_equal(read_mask(tmp_path / "c.png"), alpha[..., 0] > 0.5)


def test_exr_channels_keep_names_values_and_bytes(tmp_path):
    channels = {"opacity.A": IMAGE[..., 1], "depth.Z": 1e5 * IMAGE[..., 0]}
    for name in ("a.exr", "b.exr"):
        write_exr(tmp_path / name, channels)
    back = read_exr(tmp_path / "a.exr")
    assert set(back) == set(channels)
    for name, values in channels.items():
        np.testing.assert_array_equal(back[name], values.astype(np.float32))
    data = (tmp_path / "a.exr").read_bytes()
    assert data == (tmp_path / "b.exr").read_bytes()
    assert b"1970:01:01" in data  # not the clock's time


def test_values_that_are_not_finite_are_not_written_and_not_read(tmp_path):
    bad = IMAGE.copy()
    bad[3, 4, 0] = np.nan
    with pytest.raises(ValueError, match="1 values are not finite"):
        write_exr(tmp_path / "a.exr", {"x": bad[..., 0]})
    path = write(tmp_path / "b.exr", bad, "float")
    with pytest.raises(BadInputError, match=r"b\.exr has 1 pixels that are not finite"):
        read_image(path)


@pytest.mark.parametrize("name", ["a.jpg", "a.png"])
def test_a_file_cut_short_is_named(tmp_path, name):
    big = np.random.default_rng(1).random((200, 200, 3))
    data = write(tmp_path / name, big, "uint8").read_bytes()
    (tmp_path / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(BadInputError, match=name):
        read_image(tmp_path / name)


def test_no_picture_and_no_file_are_named(tmp_path):
    (tmp_path / "a.jpg").write_text("hello")
    with pytest.raises(BadInputError, match=r"a\.jpg is not a picture"):
        read_image(tmp_path / "a.jpg")
    with pytest.raises(BadInputError, match=r"none\.png does not exist"):
        read_header(tmp_path / "none.png")


@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_of_the_codes_0_and_1_the_1_is_inside(tmp_path, kind):
    mask = IMAGE[..., 0] > 0.6
    top = 255 if kind == "uint8" else 65535
    path = write(tmp_path / "m.png", mask / top, kind)
    np.testing.assert_array_equal(read_mask(path), mask)


@pytest.mark.parametrize("code", [2, 3, 127])
def test_a_mask_with_dark_codes_alone_is_refused_by_name(tmp_path, code):
    write_png(tmp_path / "m.png", np.full((4, 4), code, np.uint8))
    with pytest.raises(BadInputError, match=rf"m\.png holds no value above {code} of 255"):
        read_mask(tmp_path / "m.png")


def test_a_black_mask_is_empty(tmp_path):
    write_png(tmp_path / "m.png", np.zeros((4, 4), np.uint8))
    assert not read_mask(tmp_path / "m.png").any()


def test_alpha_says_where_a_picture_is_opaque(tmp_path):
    alpha = np.array([[0, 127, 128, 255]], np.uint8)
    write_png(tmp_path / "a.png", np.concatenate([np.full((1, 4, 3), 9, np.uint8), alpha[..., None]], -1))
    np.testing.assert_array_equal(read_opaque(tmp_path / "a.png"), [[False, False, True, True]])
    write_png(tmp_path / "b.png", IMAGE)
    assert read_opaque(tmp_path / "b.png") is None


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_array_is_turned_as_its_picture(tmp_path, orientation):
    pixels = np.zeros((16, 24, 3), np.float32)
    pixels[:8, :8] = 1
    path = write(tmp_path / "a.tif", pixels, "uint8", Orientation=orientation)
    np.testing.assert_array_equal(turn_upright(pixels, orientation), read_image(path))


def png_of_zeros(width: int, height: int) -> bytes:
    """A valid start of a grey PNG whose rows take a thousandth of their size."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    row = bytes(1 + width)
    block = packer.compress(row * 16) + packer.flush(zlib.Z_FULL_FLUSH)
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", block * (height // 16)) + chunk(b"IEND", b"")


@pytest.mark.parametrize(("width", "height"), [(40000, 40000), (34000, 33000), (64000, 17000)])
def test_a_picture_too_large_to_decode_is_refused_by_its_header(tmp_path, width, height):
    (tmp_path / "bomb.png").write_bytes(png_of_zeros(width, height))
    for read in (read_header, read_image, read_mask):
        with pytest.raises(BadInputError, match=rf"bomb\.png says that it is {width}x{height}.*MiB decoded, more than"):
            read(tmp_path / "bomb.png")


def test_the_suffixes_are_those_that_the_build_reads(tmp_path):
    formats = set(oiio.get_string_attribute("input_format_list").split(","))
    by_format = dict(entry.split(":") for entry in oiio.get_string_attribute("extension_list").split(";"))
    readable = {f".{suffix}" for name in formats & set(by_format) for suffix in by_format[name].split(",")}
    assert readable >= PICTURE_SUFFIXES
    assert not readable & set(UNREADABLE_SUFFIXES)
    image = np.full((64, 80, 3), 0.3, np.float32)
    for suffix in sorted(PICTURE_SUFFIXES):
        written = write(tmp_path / f"a{suffix}", image, "float" if suffix in (".exr", ".hdr") else "uint8")
        assert read_image(written).shape == image.shape
