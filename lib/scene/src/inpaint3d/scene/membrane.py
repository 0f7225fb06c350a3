"""A smooth surface over a gap in a map of numbers, spanned between what is known around it."""

import math

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from inpaint3d.scene.image_io import Mask

_ALONG = (((slice(None, -1),), (slice(1, None),)), ((slice(None), slice(None, -1)), (slice(None), slice(1, None))))
NEIGHBOURS = [pair[::way] for pair in _ALONG for way in (1, -1)]
"""Index pairs: the cells of a map with a neighbour below, above, to the right, to the left, and those neighbours."""


def span_membrane(
    values: NDArray[np.floating],
    known: Mask,
    bend: NDArray[np.floating] | None = None,
    *,
    reach: float = math.inf,
) -> NDArray[np.float64]:
    """`values` [h, w] or [h, w, c] with each unknown cell at the mean of its neighbours, `known` cells as they are.

    The discrete Laplace equation, solved by a sparse factorisation (SuperLU); a cell at the border of the map has no
    neighbour outside. 0 everywhere where nothing is known. bend, shaped as values: Poisson's equation instead, by how
    much the neighbours of an unknown cell exceed it in sum. reach, cells: what the known cells and the bend impose
    falls off by a factor of e over so many, towards 0 (the screened equation).
    """
    held = np.where(known[..., None], values.reshape(*known.shape, -1), 0.0)
    if not known.all() and known.any():
        asked = np.zeros_like(held) if bend is None else -bend.reshape(held.shape).astype(np.float64)
        matrix = _sum_differences(known, held, asked, reach**-2)
        factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        held[~known] = factors.solve(asked[~known])
    return held.reshape(values.shape)


def _sum_differences(
    known: Mask, held: NDArray[np.float64], asked: NDArray[np.float64], pull: float
) -> sparse.csc_array:
    """What takes the unknown cells [n] to the sums of their differences to all neighbours and of their own `pull` to 0,
    less what `held` gives to these sums, which is added to `asked` [h, w, c].
    """
    count = int((~known).sum())
    number = np.full(known.shape, -1)
    number[~known] = np.arange(count)
    degree, links = np.full(known.shape, pull), []
    for here, there in NEIGHBOURS:
        degree[here] += 1
        asked[here] += held[there]
        both = ~known[here] & ~known[there]
        links.append(np.stack([number[here][both], number[there][both]]))
    rows, columns = np.concatenate([*links, np.tile(np.arange(count), (2, 1))], 1)
    entries = np.concatenate([np.full(len(rows) - count, -1.0), degree[~known]])
    return sparse.csc_array((entries, (rows, columns)), shape=(count, count))
