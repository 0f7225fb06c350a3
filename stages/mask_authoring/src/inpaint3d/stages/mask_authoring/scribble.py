"""Scribble masks (M3): a path on one view, drawn by hand or random, widened by ellipses."""

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LENGTH = 1.5  # of a random path, in shorter sides
TURN_DEG = 25.0  # typical change of direction between two points of a random path
STRETCH = 1.6  # longest ellipse, against its width


def random_path(width: int, height: int, seed: int) -> Floats:
    """A winding path [n, 2] in pixels that starts in the middle half of the picture and stays inside it."""
    rng = np.random.default_rng(seed)
    size = np.array([width, height], np.float64)
    step = 0.05 * size.min()
    point, heading = size * rng.uniform(0.25, 0.75, 2), rng.uniform(0, 2 * np.pi)
    path = [point]
    for _ in range(round(LENGTH / 0.05)):
        heading += np.deg2rad(rng.normal(0, TURN_DEG))
        after = point + step * np.array([np.cos(heading), np.sin(heading)])
        if np.any(after < 0) or np.any(after > size - 1):
            heading = float(np.arctan2(*(size / 2 - point)[::-1]))  # turn back to the middle
            after = point + step * np.array([np.cos(heading), np.sin(heading)])
        point = after
        path.append(point)
    return np.stack(path)


def draw(path: Floats, width: int, height: int, thickness: float, seed: int) -> Bools:
    """The path [n, 2] drawn with ellipses of random turn, about `thickness` pixels wide -> bool [h, w]."""
    rng = np.random.default_rng(seed)
    mask = np.zeros((height, width), np.uint8)
    half = max(thickness / 2, 1.0)
    for x, y in _space_evenly(path, half):
        axes = (round(half * rng.uniform(1, STRETCH)), round(half))
        cv2.ellipse(mask, (int(x), int(y)), axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
    return mask.astype(bool)


def _space_evenly(path: Floats, spacing: float) -> Floats:
    """Points every `spacing` pixels along a polyline, both ends included."""
    if len(path) == 1:
        return path
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=-1))])
    at = np.linspace(0, length[-1], max(2, int(np.ceil(length[-1] / spacing)) + 1))
    return np.stack([np.interp(at, length, path[:, k]) for k in (0, 1)], -1)
