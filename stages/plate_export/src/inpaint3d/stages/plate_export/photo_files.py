"""Photos with the codes that their files hold, and plates written as their photos are: bits, profile, EXIF."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio  # noqa: N813 - the name its own documentation uses
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError, StorageError
from inpaint3d.scene.image_io import turn_upright

Codes = NDArray[Any]
Colours = NDArray[np.float32]

KINDS = {"uint8": oiio.UINT8, "uint16": oiio.UINT16, "float16": oiio.HALF, "float32": oiio.FLOAT}
KEPT_FORMATS = {"png": ".png", "tiff": ".tif", "openexr": ".exr"}
# What says how the file was packed, and not what it shows.
PACKING = ("Orientation", "thumbnail", "jpeg:", "png:", "openexr:", "oiio:Source", "oiio:BitsPerSample", "tiff:")


@dataclass(frozen=True, eq=False)
class PhotoFile:
    """What a file says beside its pixels; `suffix` is that of its plate."""

    spec: oiio.ImageSpec
    suffix: str
    colours: int  # 1 or 3: what follows is alpha
    linear: bool  # float files hold light, the others codes


def read_photo(path: Path) -> tuple[Codes, PhotoFile]:
    """Every channel as stored, upright [h, w, c] in uint8, uint16, float16 or float32, and what the file says.

    BadInputError for a file that is damaged.
    """
    hint = oiio.ImageSpec()
    hint.attribute("oiio:UnassociatedAlpha", 1)  # else colours come multiplied by alpha
    buffer = oiio.ImageBuf(str(path), 0, 0, hint)
    if buffer.has_error or not buffer.initialized:
        raise BadInputError(f"{path} is not a picture that can be read; replace it in the capture")
    spec = oiio.ImageSpec(buffer.spec())
    kind = _read_stored_kind(spec)
    if not buffer.read(force=True, convert=kind) or (pixels := buffer.get_pixels(kind)) is None:
        raise BadInputError(f"{path} is damaged ({buffer.geterror()}); replace it in the capture")
    codes = np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels)
    codes = turn_upright(codes, int(spec.get_int_attribute("Orientation", 1)))
    return codes, PhotoFile(spec, _choose_suffix(spec, kind), 3 if spec.nchannels >= 3 else 1, kind.startswith("float"))


def _read_stored_kind(spec: oiio.ImageSpec) -> str:
    kind = str(spec.format)
    return kind if kind in ("uint8", "uint16", "half") else "float"


def _choose_suffix(spec: oiio.ImageSpec, kind: str) -> str:
    """The photo's own format where it loses nothing, else PNG for whole numbers and OpenEXR for light."""
    own = KEPT_FORMATS.get(str(spec.get_string_attribute("oiio:SourceFileFormat", "")))
    if own is not None and not (own == ".png" and kind in ("half", "float")):
        return own
    return ".exr" if kind in ("half", "float") else ".png"


def write_plate(path: Path, codes: Codes, photo: PhotoFile) -> None:
    """Write codes [h, w, c] with the photo's depth, profile and EXIF, upright."""
    height, width = codes.shape[:2]
    spec = oiio.ImageSpec(photo.spec)
    spec.set_format(KINDS[codes.dtype.name])
    spec.width, spec.height, spec.full_width, spec.full_height = width, height, width, height
    spec.x = spec.y = spec.full_x = spec.full_y = spec.tile_width = spec.tile_height = 0
    for name in {a.name for a in spec.extra_attribs if a.name.startswith(PACKING)}:
        spec.erase_attribute(name)
    # JPEG's and others' words for their packing mean nothing to another writer.
    spec.attribute("compression", "zip")
    spec.attribute("png:compressionLevel", 2)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    spec.attribute("Orientation", 1)
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    if output is None:
        raise StorageError(f"cannot write {path}: {oiio.geterror()}")
    written = output.open(str(path), spec) and output.write_image(np.ascontiguousarray(codes))
    if not (output.close() and written):
        raise StorageError(f"cannot write {path}: {output.geterror()}; check free space and permissions")


def to_colours(codes: Codes) -> Colours:
    """Whole numbers as shares of their range, light as it is: float32."""
    if codes.dtype.kind == "u":
        return codes.astype(np.float32) * np.float32(1 / np.iinfo(codes.dtype).max)
    return codes.astype(np.float32)


def to_codes(colours: Colours, kind: np.dtype[Any]) -> Codes:
    """The inverse of `to_colours`: rounded and clipped to the range of whole numbers; light from 0 on."""
    if kind.kind == "u":
        top = np.iinfo(kind).max
        return np.rint(np.clip(colours, 0, 1) * top).astype(kind)
    return np.clip(colours, 0, float(np.finfo(kind).max)).astype(kind)
