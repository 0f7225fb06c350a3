"""The views that distillation starts from (row S8)."""

import numpy as np
from numpy.typing import NDArray


def choose_centre_views(centres: NDArray[np.float64], hole_share: NDArray[np.float64], count: int) -> list[int]:
    """The views of a small baseline that distillation starts from (S8), nearest first.

    The first is the medoid of the camera centres [n, 3] among the views that see the hole; the others are its nearest.
    """
    seeing = np.flatnonzero(hole_share > 0)
    distance = np.linalg.norm(centres[seeing, None] - centres[None, seeing], axis=-1)
    medoid = int(distance.sum(1).argmin())
    return [int(seeing[i]) for i in np.argsort(distance[medoid], kind="stable")[:count]]
