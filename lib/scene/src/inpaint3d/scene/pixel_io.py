"""Pixels as OpenImageIO reads and writes them: every file is opened, bounded, decoded and stamped here."""

from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError, StorageError

# Decoded bytes of one picture: 89 megapixels of float colour, 358 of 8-bit. A small file can claim any size.
MAX_DECODED_BYTES = 2**30
# Time stamps and host names would make equal pictures differ.
_UNSTABLE = ("DateTime", "Software", "HostComputer", "Exif:ImageHistory")

Attribute = int | float | str | tuple[float, ...]


def open_picture(path: Path) -> oiio.ImageBuf:
    """A file whose header was read, colours apart from alpha; BadInputError where it is no picture, or too large."""
    if not path.is_file():
        raise BadInputError(f"{path} does not exist; check the capture's folder")
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    buffer = oiio.ImageBuf(str(path), 0, 0, hint)
    if buffer.has_error or not buffer.initialized:
        raise BadInputError(f"{path} is not a picture that can be read ({_explain(buffer)}); replace or remove it")
    _check_size(buffer.spec(), path)
    return buffer


def _check_size(spec: oiio.ImageSpec, path: Path) -> None:
    """From the header alone: what a file claims is allocated before its first pixel is seen."""
    width, height, depth, channels = spec.width, spec.height, spec.depth, spec.nchannels
    if min(width, height, channels) < 1 or depth > 1 or spec.deep:
        raise BadInputError(f"{path} is {width}x{height}x{depth} with {channels} channels, no flat picture; remove it")
    if (size := width * height * channels * (1 if spec.format == oiio.TypeUInt8 else 4)) > MAX_DECODED_BYTES:
        raise BadInputError(
            f"{path} says that it is {width}x{height} with {channels} channels, {size // 2**20} MiB decoded, "
            f"more than {MAX_DECODED_BYTES // 2**20}; make it smaller, or remove it"
        )


def read_pixels(buffer: oiio.ImageBuf, path: Path, kind: Literal["float", "uint8", "uint16"] = "float") -> NDArray[Any]:
    """All channels [h, w, c], float32 or whole numbers, upright; BadInputError where the file is damaged."""
    if buffer.spec().get_string_attribute("oiio:SourceFileFormat", "") == "jpeg" and _cut_short(path):
        raise BadInputError(f"{path} is cut short (no end-of-image marker); copy it again or remove it")
    if not buffer.read(force=True, convert=kind) or buffer.has_error:
        raise BadInputError(f"{path} is damaged ({_explain(buffer)}); copy it again or remove it")
    upright = buffer if read_orientation(buffer.spec()) == 1 else oiio.ImageBufAlgo.reorient(buffer)
    # Where a buffer could not be turned, asking for its pixels trips an assertion of OpenImageIO.
    pixels = upright.get_pixels(kind) if upright.initialized and not upright.has_error else None
    if pixels is None:
        raise BadInputError(f"{path} is damaged ({_explain(upright)}); copy it again or remove it")
    return pixels.reshape(upright.spec().height, upright.spec().width, -1)


def _cut_short(path: Path) -> bool:
    """Whether a JPEG ends before its picture does; decoders pad with grey and don't say so.

    0xFF inside the picture's data is always followed by 0x00, so that FF D9 after the last scan's start is the end.
    """
    data = path.read_bytes()
    return data.find(b"\xff\xd9", max(data.rfind(b"\xff\xda"), 0)) < 0


def _explain(buffer: oiio.ImageBuf) -> str:
    try:
        text = buffer.geterror().strip().splitlines()
    except UnicodeDecodeError:  # it quotes the file's bytes
        return "damaged header"
    return text[0] if text else "unknown format"


def read_orientation(spec: oiio.ImageSpec) -> int:
    """EXIF orientation; 0 and what is beyond 8 say nothing, and are written all the same."""
    said = int(spec.get_int_attribute("Orientation", 1))
    return said if 1 <= said <= 8 else 1


def read_attributes(spec: oiio.ImageSpec) -> dict[str, Attribute]:
    """What a file says of its picture, but for texts that are not UTF-8: older cameras write their makers' so."""
    found: dict[str, Attribute] = {}
    for attribute in spec.extra_attribs:
        try:
            name, value = attribute.name, attribute.value
        except UnicodeDecodeError:
            continue
        if isinstance(value, (int, float, str)):
            found[name] = value
        elif isinstance(value, tuple) and all(isinstance(part, (int, float)) for part in value):
            found[name] = tuple(map(float, value))
    return found


def read_text(spec: oiio.ImageSpec, name: str) -> str:
    """An attribute; empty where there is none, or none in UTF-8."""
    try:
        return str(spec.get_string_attribute(name, ""))
    except UnicodeDecodeError:
        return ""


def is_linear(spec: oiio.ImageSpec) -> bool:
    """Whether a file holds linear light: by what it says, else by its being of floats."""
    space = read_text(spec, "oiio:ColorSpace").lower()
    if space:
        return space.startswith(("lin", "scene_linear", "acescg"))
    return oiio.TypeDesc(spec.format).basetype in (oiio.BASETYPE.HALF, oiio.BASETYPE.FLOAT, oiio.BASETYPE.DOUBLE)


def write_pixels(path: Path, spec: oiio.ImageSpec, pixels: NDArray[np.generic]) -> None:
    """Write [h, w, c] so that the same pixels give the same bytes; StorageError where that fails."""
    for name in _UNSTABLE:
        spec.erase_attribute(name)
    spec.attribute("DateTime", "1970:01:01 00:00:00")  # EXR stamps the clock where there is none
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise StorageError(f"cannot write {path}: {oiio.geterror()}")
    written = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(pixels))
    closed = output.close()
    if not (written and closed):
        raise StorageError(f"cannot write {path}: {output.geterror()}; check free space and permissions")
