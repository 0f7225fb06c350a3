"""A smooth surface over a gap in a map of numbers, spanned between what is known around it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.image_io import Mask

ROUNDS = 100
"""Relaxations at each size: what a coarser size leaves is smooth, and these see to the rest."""
NEIGHBOURS = np.array([[0, 0.25, 0], [0.25, 0, 0.25], [0, 0.25, 0]])


def span_membrane(
    values: NDArray[np.floating], known: Mask, bend: NDArray[np.floating] | None = None, *, rounds: int = ROUNDS
) -> NDArray[np.float64]:
    """`values` [h, w] with each unknown cell at the mean of its four neighbours, `known` cells as they are.

    The discrete Laplace equation, relaxed from coarse to fine; the border of the map goes on outside. Linear values
    stay linear. 0 everywhere where nothing is known. bend [h, w]: Poisson's equation instead, by how much the four
    neighbours of an unknown cell exceed it in sum. rounds: relaxations at each size.
    """
    held = np.where(known, values, 0.0)
    if known.all() or not known.any():
        return held
    bend = np.zeros_like(held) if bend is None else np.where(known, 0.0, bend)
    height, width = known.shape
    made = np.full_like(held, held[known].mean())
    if max(height, width) > 2:
        size = ((width + 1) // 2, (height + 1) // 2)
        share = cv2.resize(known.astype(np.float64), size, interpolation=cv2.INTER_AREA)
        mean = cv2.resize(held, size, interpolation=cv2.INTER_AREA) / np.maximum(share, 1e-9)
        # A cell of four has twice the side: differences of second order grow by four.
        coarse_bend = 4 * cv2.resize(bend, size, interpolation=cv2.INTER_AREA)
        coarse = span_membrane(mean, share > 0, coarse_bend, rounds=rounds)
        made = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_LINEAR)
    made = np.where(known, held, made)
    for _ in range(rounds):
        around = cv2.filter2D(made, -1, NEIGHBOURS, borderType=cv2.BORDER_REPLICATE)
        made = np.where(known, held, around - bend / 4)
    return made
