"""Maps of numbers on disk: float channels as EXR, whole numbers as 16-bit PNG."""

from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.finite import find_non_finite
from inpaint3d.scene.pixel_io import open_picture, read_pixels, write_pixels

MAX_CODE = 2**16 - 1


def write_codes(path: Path, codes: ArrayLike) -> None:
    """Write whole numbers [h, w] in [0, 65535] as a 16-bit PNG; ValueError for others."""
    codes = np.asarray(codes)
    if codes.min(initial=0) < 0 or codes.max(initial=0) > MAX_CODE:
        raise ValueError(f"{path}: codes from {codes.min()} to {codes.max()} do not fit into 16 bits")
    height, width = codes.shape
    spec = oiio.ImageSpec(width, height, 1, oiio.UINT16)
    spec.attribute("png:compressionLevel", 4)
    write_pixels(path, spec, codes.astype(np.uint16)[..., None])


def read_codes(path: Path) -> NDArray[np.uint16]:
    """Whole numbers [h, w] as `write_codes` wrote them; BadInputError for a file that is damaged."""
    return read_pixels(open_picture(path), path, "uint16")[..., 0]


def read_exr(path: Path) -> dict[str, NDArray[np.float32]]:
    """Every channel of an EXR by name, float32 [h, w] each. BadInputError where one holds what is not finite."""
    buffer = open_picture(path)
    names = buffer.spec().channelnames
    pixels = read_pixels(buffer, path)
    channels = {str(name): np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
    if strange := find_non_finite(channels):
        told = ", ".join(map(str, strange))
        raise BadInputError(f"{path} holds numbers that are not finite: {told}; run the stage that wrote it again")
    return channels


def write_exr(path: Path, channels: dict[str, ArrayLike], *, half: bool = False) -> None:
    """Write named [h, w] channels as one EXR, float32 or half; not-finite values are refused (ValueError)."""
    if not channels:
        raise ValueError(f"{path}: no channels to write")
    pixels = np.stack([np.asarray(c, np.float32) for c in channels.values()], -1)
    if not np.isfinite(pixels).all():
        raise ValueError(f"{path}: {int((~np.isfinite(pixels)).sum())} values are not finite")
    height, width, count = pixels.shape
    spec = oiio.ImageSpec(width, height, count, oiio.HALF if half else oiio.FLOAT)
    spec.channelnames = tuple(channels)
    spec.attribute("compression", "zip")
    write_pixels(path, spec, pixels)
