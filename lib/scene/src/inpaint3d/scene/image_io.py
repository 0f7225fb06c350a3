"""Pictures and masks on disk.

In memory: float32 [h, w, 3] in [0, 1], sRGB-encoded, upright. Masks: bool [h, w], True inside the hole.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.colour import from_bytes, srgb_from_linear, to_bytes
from inpaint3d.scene.finite import find_non_finite
from inpaint3d.scene.icc import ColourProfile, read_profile
from inpaint3d.scene.pixel_io import (
    Attribute,
    is_linear,
    open_picture,
    read_attributes,
    read_orientation,
    read_pixels,
    read_text,
    write_pixels,
)

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

ROWS_AT_ONCE = 256  # while colours are converted in float64
MIDDLE = 127.5 / 255
CMYK = ("CMYK", "YCCK")  # OpenImageIO's words for a JPEG of inks
# Of linear light: a share of white that no exposure leaves, and what even the brightest pixel exceeds.
MAX_WHITE, MIN_LIGHT = 0.5, 1e-3


@dataclass(frozen=True)
class Header:
    """What a file says of its picture, before any pixel is read. Sizes are as stored, not yet turned upright."""

    width: int
    height: int
    channels: int
    bits: int
    is_float: bool
    orientation: int
    format: str
    exif: dict[str, Attribute]
    profile: ColourProfile | None = None  # None: its codes are sRGB, linear light, or inks
    is_srgb: bool = True
    """Whether its codes are sRGB as they are: no profile, no linear light, no CMYK."""

    @property
    def upright_size(self) -> tuple[int, int]:
        """Width and height once EXIF orientation is applied (5 to 8 turn by a quarter)."""
        return (self.height, self.width) if self.orientation >= 5 else (self.width, self.height)


def read_header(path: Path) -> Header:
    """Size, depth and EXIF; BadInputError for a file that is no picture."""
    spec = open_picture(path).spec()
    pixel = oiio.TypeDesc(spec.format)
    profile = _profile(spec, path)
    inks = read_text(spec, "jpeg:ColorSpace") in CMYK
    return Header(
        width=spec.width,
        height=spec.height,
        channels=spec.nchannels,
        bits=8 * pixel.basesize(),
        is_float=pixel.basetype in (oiio.BASETYPE.HALF, oiio.BASETYPE.FLOAT, oiio.BASETYPE.DOUBLE),
        orientation=read_orientation(spec),
        format=str(spec.get_string_attribute("oiio:SourceFileFormat", "")),
        exif=read_attributes(spec),
        profile=profile,
        is_srgb=profile is None and not inks and not is_linear(spec),
    )


def read_image(path: Path) -> Image:
    """Any picture that OpenImageIO reads, as sRGB-encoded float32 [h, w, 3] in [0, 1], upright.

    Float files hold linear light unless they say otherwise, and are encoded; an embedded colour profile is applied;
    grey is repeated; alpha is dropped (`read_opaque` reads it).
    BadInputError for a file that is damaged, cut short, not finite, or too large to decode, and for linear light in
    other units: all but white, or all but black.
    """
    stored = read_stored(path)
    return from_bytes(stored) if stored.dtype == np.uint8 else stored.astype(np.float32, copy=False)


def read_stored(path: Path) -> Image | NDArray[np.uint8]:
    """As `read_image`, but uint8 codes in [0, 255] where the file has 8 bits: for who cuts before converting.

    `colour.from_bytes` makes of the codes what `read_image` gives, to the bit.
    """
    buffer = open_picture(path)
    linear = is_linear(buffer.spec())  # before reading, which changes the buffer's format
    profile = None if linear else _profile(buffer.spec(), path)
    eight_bits = buffer.spec().format == oiio.TypeUInt8 and not linear
    pixels = read_pixels(buffer, path, "uint8" if eight_bits else "float")
    if profile is not None:
        pixels = _convert_to_srgb(profile, pixels)
    colour = pixels[..., :3] if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, 2)
    if eight_bits:
        return np.ascontiguousarray(colour)
    if not np.isfinite(colour).all():
        count = int((~np.isfinite(colour)).any(-1).sum())
        raise BadInputError(f"{path} has {count} pixels that are not finite; export it again without them")
    if linear:
        _check_units(colour, path)
    return np.ascontiguousarray(srgb_from_linear(colour) if linear else np.clip(colour, 0, 1), np.float32)


def _check_units(light: NDArray[Any], path: Path) -> None:
    """Linear light [h, w, 3] is to be 1 where white is: with other units nearly all of a picture is white or black."""
    white, brightest = float((light >= 1).all(-1).mean()), float(light.max(initial=-np.inf))
    if white > MAX_WHITE or (brightest < MIN_LIGHT and light.any()):
        raise BadInputError(
            f"{path} holds linear light from {float(light.min()):.3g} to {brightest:.3g}, and {white:.0%} of it is "
            "white; export it in units in which white is 1"
        )


def read_opaque(path: Path) -> Mask | None:
    """Where a picture with an alpha channel is opaque by more than half, bool [h, w], upright; None without one.

    BadInputError where alpha is not finite.
    """
    buffer = open_picture(path)
    channel = buffer.spec().alpha_channel
    if channel < 0:
        return None
    alpha = read_pixels(buffer, path)[..., channel]
    if strange := int((~np.isfinite(alpha)).sum()):
        raise BadInputError(f"{path} has {strange} pixels whose alpha is not finite; export it again without them")
    return alpha > MIDDLE


def read_mask(path: Path, size: tuple[int, int] | None = None) -> Mask:
    """A mask as bool [h, w]: above the middle of its range is inside, and so is 1 of the codes 0 and 1.

    `size` = (width, height) checks the shape. BadInputError where a value is not finite, and where nothing but a few
    dark codes is set: which of them mean the inside cannot be told.
    """
    buffer = open_picture(path)
    step = _find_code_step(buffer.spec())  # before reading, which changes the buffer's format
    pixels = read_pixels(buffer, path)
    # Transparent cut-outs (white everywhere, shape in alpha) are masks too.
    grey = pixels[..., :3].max(-1)
    if pixels.shape[2] in (2, 4) and np.ptp(grey) == 0:
        grey = pixels[..., -1]
    if size is not None and grey.shape[::-1] != tuple(size):
        raise BadInputError(
            f"mask {path} is {grey.shape[1]}x{grey.shape[0]} but its image is {size[0]}x{size[1]}; "
            "make the mask again on this image"
        )
    if strange := int((~np.isfinite(grey)).sum()):
        raise BadInputError(f"mask {path} has {strange} pixels that are not finite; save it as black and white")
    top = float(grey.max(initial=0.0))
    if step and 0 < top <= MIDDLE:
        if round(top / step) == 1:
            return grey > 0
        raise BadInputError(
            f"mask {path} holds no value above {round(top / step)} of {round(1 / step)}; "
            "save the inside of the hole as white"
        )
    return grey > MIDDLE


def turn_upright(pixels: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Stored pixels [h, w, ...] as EXIF orientation 1 to 8 has them shown."""
    turned = pixels.swapaxes(0, 1) if orientation >= 5 else pixels
    if orientation in (3, 4, 7, 8):
        turned = turned[::-1]
    return np.ascontiguousarray(turned[:, ::-1] if orientation in (2, 3, 6, 7) else turned)


def write_png(path: Path, image: ArrayLike) -> None:
    """Write [h, w, 3] or [h, w] in [0, 1] (or uint8 as it is) as an 8-bit PNG; the same pixels give the same bytes.

    Values that are not finite, which have no code, are refused (ValueError).
    """
    image = np.asarray(image)
    if found := find_non_finite({path.name: image}):
        raise ValueError(f"{path}: values that are not finite: {found[0]}")
    pixels = image if image.dtype == np.uint8 else to_bytes(image)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8)
    spec.attribute("png:compressionLevel", 4)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("oiio:ColorSpace", "srgb_rec709_scene")
    write_pixels(path, spec, pixels)


def write_mask(path: Path, mask: ArrayLike) -> None:
    """Write bool [h, w] as an 8-bit PNG: 255 inside, 0 outside."""
    write_png(path, np.where(np.asarray(mask, bool), np.uint8(255), np.uint8(0)))


def _find_code_step(spec: oiio.ImageSpec) -> float | None:
    """The smallest step between two values of a file with whole numbers, 0 to 1; None for a float file."""
    return 1 / 255 if spec.format == oiio.TypeUInt8 else 1 / 65535 if spec.format == oiio.TypeUInt16 else None


def _profile(spec: oiio.ImageSpec, path: Path) -> ColourProfile | None:
    """The embedded profile where applying it changes anything."""
    data = spec.getattribute("ICCProfile")
    if data is None:
        return None
    try:
        profile = read_profile(np.asarray(data, np.uint8).tobytes())
    except (ValueError, np.linalg.LinAlgError) as error:
        raise BadInputError(f"{path}: its colour profile: {error}; convert the picture to sRGB") from error
    if profile is None or profile.is_srgb or len(profile.curves) > spec.nchannels:
        return None
    return profile


def _convert_to_srgb(profile: ColourProfile, pixels: NDArray[Any]) -> NDArray[Any]:
    """Pixels [h, w, c] as sRGB [h, w, 3] of the same kind; a block of rows at a time, for memory's sake."""
    result = np.empty((*pixels.shape[:2], 3), pixels.dtype)
    for top in range(0, len(pixels), ROWS_AT_ONCE):
        rows = pixels[top : top + ROWS_AT_ONCE, :, : len(profile.curves)]
        whole = rows.dtype == np.uint8
        colours = profile.srgb(from_bytes(rows) if whole else rows)
        result[top : top + ROWS_AT_ONCE] = to_bytes(colours) if whole else colours
    return result
