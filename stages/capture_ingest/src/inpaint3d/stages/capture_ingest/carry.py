"""A found picture becomes a frame of the capture: decoded once, upright, sRGB, with its mask at its size."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import CapturedFrame, Exif
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import (
    Header,
    Mask,
    read_header,
    read_mask,
    read_opaque,
    read_stored,
    turn_upright,
    write_mask,
    write_png,
)
from inpaint3d.stages.capture_ingest.found import FoundFrame
from inpaint3d.stages.capture_ingest.lenses import stated_frame

KEPT_AS_THEY_ARE = ("jpeg", "png")
FILM_WIDTH_MM = 36.0
WITH_ALPHA = (2, 4)


@dataclass(frozen=True)
class Carried:
    """A frame as the artifact lists it, and what a person should know of it."""

    frame: CapturedFrame
    mask_share: float | None
    """How much of the picture its mask covers; None without one."""
    transparent_share: float


def carry(frame: FoundFrame, folder: Path) -> Carried:
    """Decode a picture (a damaged one is found here), carry it over below `folder`, resample its mask to its size."""
    header = read_header(frame.image)
    codes = read_stored(frame.image)
    height, width = codes.shape[:2]
    opaque = read_opaque(frame.image) if header.channels in WITH_ALPHA else None
    if opaque is not None and opaque.all():
        opaque = None
    target, original = _write_picture(frame, header, codes, opaque, folder)
    mask = None if frame.mask is None else fit_mask(frame.mask, header, hole_is_black=frame.hole_is_black)
    if mask is not None:
        write_mask(_name_new(folder / "masks" / f"{frame.name}.png", frame), mask)
    return Carried(
        CapturedFrame(
            name=frame.name,
            path=f"frames/{target.name}",
            original=None if original is None else f"originals/{original.name}",
            width=width,
            height=height,
            exif=read_exif(header, width, height),
            camera=frame.camera,
            other_pose=frame.other_pose,
            mask=None if mask is None else f"masks/{frame.name}.png",
        ),
        None if mask is None else float(mask.mean()),
        0.0 if opaque is None else float(1 - opaque.mean()),
    )


def _write_picture(
    frame: FoundFrame, header: Header, codes: NDArray[np.generic], opaque: Mask | None, folder: Path
) -> tuple[Path, Path | None]:
    """Byte for byte where that is an upright 8-bit sRGB file already; transparent pixels stay transparent.

    Where it is not, the file goes along as it is, for who needs all that it holds.
    """
    whole = header.bits == 8 and header.orientation == 1 and header.is_srgb and opaque is None
    as_it_is = header.format in KEPT_AS_THEY_ARE and whole
    suffix = ".jpg" if as_it_is and header.format == "jpeg" else ".png"
    target = _name_new(folder / "frames" / f"{frame.name}{suffix}", frame)
    target.parent.mkdir(parents=True, exist_ok=True)
    if as_it_is:
        shutil.copyfile(frame.image, target)
    elif opaque is None:
        write_png(target, codes)
    else:
        write_png(target, _fill_transparent(frame, codes if codes.dtype == np.uint8 else to_bytes(codes), opaque))
    original = None if as_it_is else folder / "originals" / f"{frame.name}{frame.image.suffix.lower()}"
    if original is not None:
        original.parent.mkdir(exist_ok=True)
        shutil.copyfile(frame.image, original)
    return target, original


def _name_new(target: Path, frame: FoundFrame) -> Path:
    if target.exists():
        raise BadInputError(f"{frame.image.name}: another picture has the name {frame.name} already; rename one")
    return target


def _fill_transparent(frame: FoundFrame, codes: NDArray[np.generic], opaque: Mask) -> NDArray[np.uint8]:
    """RGBA [h, w, 4] whose transparent pixels have the colour of the nearest opaque one: no edge where nothing is."""
    if not opaque.any():
        raise BadInputError(f"{frame.image.name} is transparent everywhere; remove it")
    blank = np.where(opaque, np.uint8(0), np.uint8(255))
    _, numbers = cv2.distanceTransformWithLabels(blank, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    labels = np.asarray(numbers, np.int64)
    nearest = np.zeros(int(labels.max()) + 1, np.int64)
    nearest[labels[opaque]] = np.flatnonzero(opaque)
    filled = codes.reshape(-1, 3)[nearest[labels]]
    return np.concatenate([filled, np.where(opaque, np.uint8(255), np.uint8(0))[..., None]], -1).astype(np.uint8)


def fit_mask(path: Path, header: Header, *, hole_is_black: bool = False) -> Mask:
    """The mask at its picture's upright size, turned as EXIF turns the picture where it is of the stored pixels.

    BadInputError where its aspect ratio is another: it is of another picture.
    """
    mask = read_mask(path)
    if hole_is_black:
        mask = ~mask
    try:
        _, orientation = stated_frame(header, (mask.shape[1], mask.shape[0]))
    except ValueError as error:
        raise BadInputError(f"mask {path.name} {error}; make the mask on that picture") from error
    mask = turn_upright(mask, orientation)
    if mask.shape[::-1] == header.upright_size:
        return mask
    return cv2.resize(mask.astype(np.uint8), header.upright_size, interpolation=cv2.INTER_NEAREST).astype(bool)


def read_exif(header: Header, width: int, height: int) -> Exif:
    """What the camera recorded, as far as it makes sense."""
    values = header.exif

    def number(low: float, high: float, *names: str) -> float | None:
        for name in names:
            value = values.get(name)
            if isinstance(value, (int, float)) and low <= value <= high:
                return float(value)
        return None

    film = number(1, 1e5, "Exif:FocalLengthIn35mmFilm")
    make, model = (str(values.get(k, "")).strip() for k in ("Make", "Model"))
    return Exif(
        focal_px=film / FILM_WIDTH_MM * max(width, height) if film else None,
        exposure_s=number(1e-9, 1e6, "ExposureTime", "Exif:ExposureTime"),
        iso=number(1e-3, 1e8, "Exif:PhotographicSensitivity", "Exif:ISOSpeedRatings"),
        f_number=number(1e-2, 1e4, "FNumber", "Exif:FNumber"),
        camera=f"{make} {model}".strip() or None,
        position=_read_position(values),
    )


def _read_position(values: Mapping[str, object]) -> tuple[float, float, float] | None:
    """Latitude, longitude (degrees) and altitude (m, 0 where it is not told); None where GPS told no place."""
    angles: list[float] = []
    for name, negative in (("GPS:Latitude", "S"), ("GPS:Longitude", "W")):
        parts = values.get(name)
        if not isinstance(parts, tuple) or len(parts) != 3 or not np.isfinite(parts).all():
            return None
        degrees = parts[0] + parts[1] / 60 + parts[2] / 3600
        angles.append(-degrees if str(values.get(f"{name}Ref")).strip() == negative else degrees)
    altitude = values.get("GPS:Altitude")
    height = float(altitude) if isinstance(altitude, (int, float)) and np.isfinite(altitude) else 0.0
    if not (abs(angles[0]) <= 90 and abs(angles[1]) <= 180 and any(angles)):
        return None
    return angles[0], angles[1], height
