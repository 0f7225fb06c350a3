"""Splats as SPZ (Niantic), about a tenth of the PLY: https://github.com/nianticlabs/spz, version 3 of its format."""

import gzip
import math
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.splat_export.cloud import Y_UP, Floats, SplatCloud

MAGIC, VERSION, DEGREE = 0x5053474E, 3, 0
POSITION_BITS = 24
SCALE_STEPS, SCALE_SHIFT = 16, 10  # a scale is (ln s + 10) * 16
COLOUR_STEPS = 0.15  # a coefficient is c * 0.15 + 0.5
ROTATION_STEPS = 511  # of a quaternion's part, up to sqrt(1/2)


def write_spz(path: Path, cloud: SplatCloud) -> None:
    """Y up (SPZ's right, up, back). Places are kept to at least 24 bits' share of the scene's reach; scales to 1/32 of
    their logarithm, in e^-10 to e^5.9 scene units; colours and opacities to 8 bits, rotations to 10 for each part.
    """
    turned = cloud.turn(Y_UP)
    bits = choose_fraction_bits(turned.mean)
    places = np.round(turned.mean.astype(np.float64) * 2.0**bits).astype("<i4")
    parts = [
        places.view(np.uint8).reshape(-1, 4)[:, :3],  # the lower three bytes of each number
        _to_byte(turned.alpha * 255),
        _to_byte((turned.coefficients * COLOUR_STEPS + 0.5) * 255),
        _to_byte((turned.log_scale + SCALE_SHIFT) * SCALE_STEPS),
        pack_rotations(turned.quaternion),
    ]
    header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(cloud), DEGREE, bits, 0, 0)
    body = b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
    path.write_bytes(gzip.compress(header + body, mtime=0))  # no time, so that equal splats give equal bytes


def choose_fraction_bits(mean: Floats) -> int:
    """Bits behind the point, as many as leave room for the farthest place. BadInputError where there are none."""
    reach = float(np.abs(mean).max(initial=0.0))
    bits = POSITION_BITS - 1 - max(0, math.floor(math.log2(reach)) + 1 if reach > 0 else 0)
    if bits < 0:
        raise BadInputError(f"a splat lies {reach:g} scene units away; SPZ holds 2^23, leave it out of formats")
    return bits if round(reach * 2**bits) < 2 ** (POSITION_BITS - 1) else bits - 1


def pack_rotations(quaternion: Floats) -> NDArray[np.uint8]:
    """Unit quaternions w, x, y, z -> four bytes each [n, 4].

    In two bits which of x, y, z, w is the largest, taken as positive; the other three in a sign and nine bits each.
    """
    parts = np.roll(quaternion, -1, axis=1).astype(np.float64)
    rows = np.arange(len(parts))
    largest = np.abs(parts).argmax(1)
    parts = np.where(parts[rows, largest][:, None] < 0, -parts, parts)
    packed = largest.astype(np.uint32)
    for part in range(4):
        size = np.floor(np.abs(parts[:, part]) * (ROTATION_STEPS * math.sqrt(2)) + 0.5).astype(np.uint32)
        code = ((parts[:, part] < 0).astype(np.uint32) << 9) | np.minimum(size, ROTATION_STEPS)
        packed = np.where(largest == part, packed, (packed << 10) | code)
    return packed.astype("<u4").view(np.uint8).reshape(-1, 4)


def _to_byte(values: Floats) -> NDArray[np.uint8]:
    return np.round(values).clip(0, 255).astype(np.uint8)
