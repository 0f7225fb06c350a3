from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Level = tuple[int, int, int, bool]  # resolution, first entry, entries, dense

def isas() -> list[str]:
    """Paths that this processor runs, best first: of avx512, avx2, portable."""

def isa() -> str:
    """The path in use; the best one at first."""

def set_isa(name: str) -> None:
    """Force a path. ValueError where this processor or build has none of that name."""

def hash_forward(points: Array, table: Array, levels: Sequence[Level], out: Array, *, threads: int = 1) -> None:
    """Write the trilinear features of points [n, 3] in table [entries, c], 1 <= c <= 8, to out [n, levels * c]."""

def hash_backward(
    points: Array, out_grad: Array, levels: Sequence[Level], table_grad: Array, *, threads: int = 1
) -> None:
    """Add the gradient of hash_forward's table, given out_grad [n, levels * c], to table_grad [entries, c]."""

def adam(
    param: Array,
    grad: Array,
    m: Array,
    v: Array,
    *,
    step: int,
    lr: float,
    beta1: float,
    beta2: float,
    eps: float,
    threads: int = 1,
) -> None:
    """One step of Adam in place on flat param, m and v [n]; `step` counts from 1. Denormal moments become zero."""
