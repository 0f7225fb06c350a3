"""Random holes to train a prior on: rectangles, free-form strokes and blobs, the kinds that the product makes (D4)."""

from collections.abc import Callable, Mapping

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

HoleMask = Bool[np.ndarray, "size size"]
Kind = Callable[[int, np.random.Generator], np.ndarray]

STANDARD_MIX: Mapping[str, float] = {"rectangles": 0.3, "strokes": 0.25, "blobs": 0.45}
"""Shares of the kinds. Projected spheres and objects, the commonest request, are blobs."""


def random_masks(
    count: int, size: int, rng: np.random.Generator, mix: Mapping[str, float] = STANDARD_MIX
) -> Bool[np.ndarray, "count size size"]:
    """`count` masks of size x size pixels, True inside the hole; none is empty, none leaves nothing known.

    Raises ValueError for a kind that does not exist or shares that do not sum to 1.
    """
    unknown = sorted(set(mix) - set(_KINDS))
    if unknown or abs(sum(mix.values()) - 1) > 1e-6:
        raise ValueError(f"mask mix {dict(mix)}: kinds are {sorted(_KINDS)} and their shares sum to 1")
    kinds = rng.choice(list(mix), size=count, p=list(mix.values()))
    return np.stack([_draw_usable(_KINDS[kind], size, rng) for kind in kinds])


def _draw_usable(kind: Kind, size: int, rng: np.random.Generator) -> HoleMask:
    while True:
        mask = kind(size, rng) > 0
        # A prior learns nothing from a hole of a few pixels, nor from a picture without surroundings.
        if 0.01 < mask.mean() < 0.95:
            return mask


def rectangles(size: int, rng: np.random.Generator) -> UInt8[np.ndarray, "size size"]:
    """One to three boxes, sides of an eighth to a half of the picture."""
    mask = np.zeros((size, size), np.uint8)
    for _ in range(rng.integers(1, 4)):
        width, height = rng.uniform(0.125, 0.5, 2) * size
        x, y = rng.uniform(0, size - width), rng.uniform(0, size - height)
        cv2.rectangle(mask, (int(x), int(y)), (int(x + width), int(y + height)), 1, -1)
    return mask


def strokes(size: int, rng: np.random.Generator) -> UInt8[np.ndarray, "size size"]:
    """Thick brush strokes that turn at random (DeepFill v2, arXiv:1806.03589, algorithm 1)."""
    mask = np.zeros((size, size), np.uint8)
    for _ in range(rng.integers(2, 7)):
        point = rng.uniform(0, size, 2)
        angle = rng.uniform(0, 2 * np.pi)
        thickness = max(1, round(rng.uniform(0.06, 0.2) * size))
        for _ in range(rng.integers(3, 9)):
            angle += rng.uniform(-1, 1) * np.pi / 2
            end = np.clip(point + rng.uniform(0.1, 0.35) * size * np.array([np.cos(angle), np.sin(angle)]), 0, size - 1)
            cv2.line(mask, tuple(map(int, point)), tuple(map(int, end)), 1, thickness)
            point = end
    return mask


def blobs(size: int, rng: np.random.Generator) -> UInt8[np.ndarray, "size size"]:
    """One to three ellipses with a wavy rim, possibly over the border: what a sphere or an object projects to."""
    mask = np.zeros((size, size), np.uint8)
    angles = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    for _ in range(rng.integers(1, 4)):
        radius = np.ones_like(angles)
        for frequency in range(2, 6):
            radius += rng.uniform(0, 0.12) * np.cos(frequency * angles + rng.uniform(0, 2 * np.pi))
        axes = rng.uniform(0.1, 0.38, 2) * size
        outline = np.stack([axes[0] * radius * np.cos(angles), axes[1] * radius * np.sin(angles)], axis=-1)
        turn = rng.uniform(0, np.pi)
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        polygon = outline @ rotation.T + rng.uniform(0.1, 0.9, 2) * size
        cv2.fillPoly(mask, [np.round(polygon).astype(np.int32)], 1)
    return mask


_KINDS: Mapping[str, Kind] = {"rectangles": rectangles, "strokes": strokes, "blobs": blobs}
