"""ICC profiles of the matrix and curve kind (ICC.1:2010, sections 8.3 and 10), which cameras and phones embed.

A profile says of its codes which light they mean: a curve for each channel, then a matrix to CIE XYZ under D50.
"""

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.colour import srgb_from_linear

Floats = NDArray[np.float64]

# sRGB's primaries adapted to D50, as its own profile has them (IEC 61966-2-1 by Bradford's method).
XYZ_FROM_SRGB = np.array(
    [[0.43607, 0.38515, 0.14307], [0.22249, 0.71687, 0.06061], [0.01392, 0.09708, 0.71410]], np.float64
)
ENTRIES = 4096  # of a curve; between them it is straight
ONE_CODE = 1.0 / 255.0
_HEADER, _SIGNATURE_AT = 128, 36
# Parameters of `para` curves by their type (table 65): g, a, b, c, d, e, f.
_PARAMETERS = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}


@dataclass(frozen=True, eq=False)
class ColourProfile:
    """Curves [c, ENTRIES], linear light of evenly spaced codes, and a matrix [3, c], linear sRGB of that light."""

    description: str
    curves: Floats
    srgb_from_light: Floats

    def srgb(self, encoded: NDArray[np.floating]) -> NDArray[np.float32]:
        """Codes [*n, c] in [0, 1] as sRGB-encoded colours [*n, 3]; what sRGB cannot show is clipped."""
        at = np.linspace(0.0, 1.0, ENTRIES)
        light = np.stack([np.interp(encoded[..., i], at, curve) for i, curve in enumerate(self.curves)], -1)
        return srgb_from_linear(light @ self.srgb_from_light.T).astype(np.float32)

    @property
    def is_srgb(self) -> bool:
        """Whether no 8-bit code changes by more than one."""
        codes = np.stack(np.meshgrid(*[np.linspace(0, 1, 9)] * 3, indexing="ij"), -1)
        channels = len(self.curves)
        given = codes if channels == 3 else codes[..., :1] * np.ones(channels)
        meant = codes if channels == 3 else np.repeat(codes[..., :1], 3, -1)
        return bool(np.abs(self.srgb(given) - meant).max() <= ONE_CODE)


def read_profile(data: bytes) -> ColourProfile | None:
    """The profile, or None for one of CMYK, whose pixels arrive converted.

    Raises ValueError where it is damaged, or of the kind with tables alone.
    """
    try:
        if data[_SIGNATURE_AT : _SIGNATURE_AT + 4] != b"acsp":
            raise ValueError("no profile's signature")
        space = data[16:20]
        tags = _read_tags(data)
        if space == b"GRAY" and b"kTRC" in tags:
            return ColourProfile(_describe(tags), _read_curve(tags[b"kTRC"])[None], np.ones((3, 1)))
        if space != b"RGB ":
            return None
        if missing := {b"rXYZ", b"gXYZ", b"bXYZ", b"rTRC", b"gTRC", b"bTRC"} - set(tags):
            raise ValueError(f"it has no {', '.join(sorted(m.decode() for m in missing))}: tables alone are not read")
        curves = np.stack([_read_curve(tags[b"%cTRC" % c]) for c in b"rgb"])
        matrix = np.stack([_read_xyz(tags[b"%cXYZ" % c]) for c in b"rgb"], 1)
    except (struct.error, IndexError, OverflowError) as error:
        raise ValueError(f"it is damaged ({error})") from error
    if not (np.isfinite(matrix).all() and np.isfinite(curves).all()):
        raise ValueError("it is damaged (values that are not finite)")
    return ColourProfile(_describe(tags), curves, np.asarray(np.linalg.solve(XYZ_FROM_SRGB, matrix), np.float64))


def _read_tags(data: bytes) -> dict[bytes, bytes]:
    (count,) = struct.unpack_from(">I", data, _HEADER)
    if count > 1000:
        raise ValueError(f"it is damaged ({count} tags)")
    entries = [struct.unpack_from(">4sII", data, _HEADER + 4 + 12 * i) for i in range(count)]
    return {key: data[start : start + size] for key, start, size in entries}


def _read_xyz(tag: bytes) -> Floats:
    if tag[:4] != b"XYZ ":
        raise ValueError(f"it is damaged (a colour of type {tag[:4]!r})")
    return np.array(struct.unpack_from(">3i", tag, 8)) / 65536


def _read_curve(tag: bytes) -> Floats:
    """Linear light of evenly spaced codes, [ENTRIES]."""
    x = np.linspace(0.0, 1.0, ENTRIES)
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return x
        values = np.array(struct.unpack_from(f">{min(count, len(tag))}H", tag, 12), np.float64)
        if count == 1:
            return x ** (values[0] / 256)
        return np.interp(x, np.linspace(0.0, 1.0, count), values / 65535)
    if tag[:4] != b"para":
        raise ValueError(f"it is damaged (a curve of type {tag[:4]!r})")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind not in _PARAMETERS:
        raise ValueError(f"it is damaged (a curve of kind {kind})")
    return _evaluate_parametric(kind, [v / 65536 for v in struct.unpack_from(f">{_PARAMETERS[kind]}i", tag, 12)], x)


def _evaluate_parametric(kind: int, values: list[float], x: Floats) -> Floats:
    """Table 65: (a x + b)^g + e from d on, c x + f below; what a kind leaves out is 0 (and a is 1)."""
    g, a, b, c, d, e, f = [*values, *[1.0, 0.0, 0.0, 0.0, 0.0, 0.0][len(values) - 1 :]]
    if kind in (1, 2):
        if a == 0:
            raise ValueError("it is damaged (a curve without a slope)")
        d = -b / a
        e = f = c if kind == 2 else 0.0
        c = 0.0
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return np.where(x >= d, np.maximum(a * x + b, 0.0) ** g + e, c * x + f)


def _describe(tags: dict[bytes, bytes]) -> str:
    """The profile's own name, as far as it is plain text."""
    tag = tags.get(b"desc", b"")
    if tag[:4] == b"desc" and len(tag) >= 12:
        (size,) = struct.unpack_from(">I", tag, 8)
        return tag[12 : 12 + size].split(b"\0")[0].decode("ascii", "replace")
    if tag[:4] == b"mluc" and len(tag) >= 28:
        size, start = struct.unpack_from(">II", tag, 20)
        return tag[start : start + size].decode("utf-16-be", "replace")
    return "without a name"
