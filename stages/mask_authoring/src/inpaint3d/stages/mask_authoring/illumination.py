"""How much of its light an object keeps from the surface that it stands on.

A shadow's shape is known up to the light, since the object's is: of every direction from which light may come, the hull
casts a shadow of its own, and any shadow is a sum of these with weights that are not negative (Sato, Sato and Ikeuchi,
"Illumination from Shadows", PAMI 2003, doi:10.1109/TPAMI.2003.1182093). The weights are fitted to differences of
brightness between places of one material, found by what shading leaves alone: hue, and the grain of the texture.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import KDTree

from inpaint3d.stages.mask_authoring.flat_surface import Texture

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

TILTS = (0.4, 0.8, 1.4, 2.2)  # of lights: length of the shadow of a stick, in sticks
TURNS = 16  # directions around, of each tilt
PENUMBRA = 1.0  # cells, standard deviation
RINGS = (0.0, 0.02, 0.05, 0.1)  # shares of the sky that the object hides: partners are looked for in each of these
PARTNERS = 4  # places of the same material, of each ring
APART = 4.0  # cells between partners, at least: nearer ones look alike by their blur
ALIKE = 0.08  # by how much the description of one material varies, log units
HUE_OF_BLUE = 0.2  # weight of blue against green: the sky lights a shadow otherwise than the lamp
ROUNDS = 5  # of reweighting
SPREAD = 1.5  # of the typical residual: larger ones count less (Cauchy)
MOST = 24000  # pairs, spread over the surface: more change nothing but the time
ENOUGH = 10  # pairs for a light, at least
SPARSENESS, DAMPING = 0.01, 1e-3  # of the single lights, against one sky that shines from everywhere


@dataclass(frozen=True, eq=False)
class Darkening:
    """share: of the light that the object keeps from each cell [side, side]; gain: by how much that explains the
    differences between places of one material better than light that only drifts over the surface (log likelihood).
    """

    share: Floats
    gain: float


@dataclass(frozen=True, eq=False)
class Pairs:
    """Places of one material: rows of the known cells, the difference of their log brightness, weights; all [n]."""

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    difference: Floats
    weight: Floats


def cast_shadows(slices: Sequence[Bools], step: float) -> Floats:
    """Shadows [1 + lights, side, side] in [0, 1] of a hull cut every `step` cells: from an even sky and each light."""
    side = len(slices[0])
    shifts = [np.zeros(2)]
    for tilt in TILTS:
        angles = np.linspace(0, 2 * np.pi, TURNS, endpoint=False)
        shifts += list(tilt * np.stack([np.cos(angles), np.sin(angles)], -1))
    cast = np.zeros((len(shifts), side, side), np.float32)
    for height, held in enumerate(slices):
        for shadow, shift in zip(cast, shifts, strict=True):
            np.maximum(shadow, _move(held.astype(np.float32), height * step * shift), out=shadow)
    soft = np.stack([cv2.GaussianBlur(shadow, (0, 0), PENUMBRA) for shadow in cast]).astype(np.float64)
    return np.concatenate([soft.mean(0, keepdims=True), soft])


def move_shadows(cast: Floats, shift: Floats) -> Floats:
    """The shadows of the same object elsewhere, by a shift (columns, rows) [2] in cells."""
    return np.stack([_move(shadow.astype(np.float32), shift) for shadow in cast]).astype(np.float64)


def fit_darkening(texture: Texture, usable: Bools, cast: Floats) -> Darkening | None:
    """Weights of the lights by non-negative least squares, reweighted; None where too few places have partners.

    usable: cells [side, side] that may count.
    """
    shadows = cast[:, usable]
    pairs = _find_pairs(texture, usable, shadows[0])
    if len(pairs.first) < ENOUGH * len(cast):
        return None
    drift = _make_drift(usable)
    between = pairs.first, pairs.second
    dark = -(shadows.T[between[0]] - shadows.T[between[1]])
    drifting = drift[between[0]] - drift[between[1]]
    lights, plain = (_solve(m, drifting, pairs) for m in (dark, dark[:, :0]))
    scale = _typical(lights[1])
    costs = [float((pairs.weight * np.log1p((r / (SPREAD * scale)) ** 2)).sum()) for r in (plain[1], lights[1])]
    # Light of 1 is all of it; more is the misfit of a hull that is a little larger than the object.
    return Darkening(np.clip(np.tensordot(lights[0], cast, 1), 0, 1), costs[0] - costs[1])


def _solve(dark: Floats, drifting: Floats, pairs: Pairs) -> tuple[Floats, Floats]:
    """Weights of the columns of `dark` [n, k], and residuals [n], as robust as the Cauchy loss."""
    columns = np.concatenate([dark, drifting, -drifting], 1)
    count, weight = dark.shape[1], pairs.weight
    found, residual = np.zeros(columns.shape[1]), pairs.difference
    for _ in range(ROUNDS):
        gram = columns.T @ (weight[:, None] * columns)
        right = columns.T @ (weight * pairs.difference)
        typical = float(np.trace(gram[:count, :count])) / max(1, count)
        gram[np.arange(1, count), np.arange(1, count)] += DAMPING * typical
        right[1:count] -= SPARSENESS * typical
        gram += 1e-8 * float(np.trace(gram)) / len(gram) * np.eye(len(gram))
        lower = np.linalg.cholesky(gram)
        found, _ = nnls(lower.T, np.linalg.solve(lower, right))
        residual = pairs.difference - columns @ found
        weight = pairs.weight / (1 + (residual / (SPREAD * _typical(residual))) ** 2)
    return found[:count], residual


def _typical(residual: Floats) -> float:
    return max(1e-3, 1.48 * float(np.median(np.abs(residual))))


def _find_pairs(texture: Texture, usable: Bools, sky: Floats) -> Pairs:
    """For each usable cell the most alike ones, in each ring about the object that is hidden less from the sky [n]."""
    described, bright = _describe(texture.log_colour, usable)
    described, bright = described[usable] / ALIKE, bright[usable]
    rows, columns = np.nonzero(usable)
    places = np.stack([columns, rows], -1)
    first, second, apart = [], [], []
    for low, high in zip(RINGS, (*RINGS[1:], np.inf), strict=True):
        ring = np.flatnonzero((sky >= low) & (sky < high))
        if len(ring) < PARTNERS:
            continue
        distance, found = KDTree(described[ring]).query(described, PARTNERS)
        first.append(np.repeat(np.arange(len(described)), PARTNERS))
        second.append(ring[found].ravel())
        apart.append(distance.ravel())
    a, b, distance = (np.concatenate(part) if part else np.zeros(0, np.int64) for part in (first, second, apart))
    kept = (np.linalg.norm(places[a] - places[b], axis=-1) > APART) & (distance < 2) & (sky[a] >= sky[b])
    kept = np.flatnonzero(kept)[:: -(-int(kept.sum()) // MOST) or 1]
    a, b, weight = a[kept], b[kept], np.exp(-0.5 * distance[kept] ** 2)
    # A cell counts once, however many partners it has.
    weight = weight / np.maximum(np.bincount(a, weight, minlength=len(described))[a], 0.5)
    return Pairs(a, b, bright[a] - bright[b], weight)


def _describe(log_colour: Floats, usable: Bools) -> tuple[Floats, Floats]:
    """What shading leaves alone [side, side, 6], hue and grain at two scales; brightness [side, side]; logs."""
    red, green, blue = np.moveaxis(log_colour, -1, 0)
    hue = np.stack([red - green, HUE_OF_BLUE * (blue - green)], -1)
    brightness = ((red + green) / 2)[..., None]
    blurred = {width: _blur(brightness, usable, width) for width in (0.5, 1.0, 1.5, 3.0)}
    grain = [blurred[0.5] - blurred[1.5], blurred[1.0] - blurred[3.0]]
    described = np.concatenate([_blur(hue, usable, 0.5), _blur(hue, usable, 1.5), *grain], -1)
    return described, blurred[0.5][..., 0]


def _blur(values: Floats, usable: Bools, width: float) -> Floats:
    """Values [side, side, c] blurred over the usable cells alone, by a Gaussian of that many cells."""
    weight = cv2.GaussianBlur(usable.astype(np.float64), (0, 0), width)
    blurred = cv2.GaussianBlur(np.where(usable[..., None], values, 0.0), (0, 0), width)
    return blurred.reshape(values.shape) / np.maximum(weight, 1e-3)[..., None]


def _make_drift(usable: Bools) -> Floats:
    """Light that drifts over the surface: polynomials up to the second degree at the usable cells, [n, 5]."""
    rows, columns = np.nonzero(usable)
    x, y = columns / usable.shape[1] - 0.5, rows / usable.shape[0] - 0.5
    return np.stack([x, y, x * x, y * y, x * y], -1)


def _move(picture: NDArray[np.float32], shift: Floats) -> NDArray[np.float32]:
    """A picture [h, w] moved by (columns, rows); zeros come in."""
    move = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float32)
    return np.asarray(cv2.warpAffine(picture, move, picture.shape[::-1], flags=cv2.INTER_LINEAR), np.float32)
