"""Which numbers of arrays are not finite: told by name and place, before anything is kept or believed."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray


class NonFinite(NamedTuple):
    """What of an array is not finite."""

    array: str
    numbers: int
    first: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.array} ({self.numbers}, the first at {list(self.first)})"


def find_non_finite(arrays: Mapping[str, NDArray[Any]]) -> list[NonFinite]:
    """Which of the arrays hold numbers that are not finite. Costs one sum of each as long as none does."""
    found: list[NonFinite] = []
    for name, array in arrays.items():
        if not np.issubdtype(array.dtype, np.floating):
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            if np.isfinite(array.sum()):
                continue
        # A sum may overflow by itself: only a look at each number tells.
        places = np.argwhere(~np.isfinite(array))
        if len(places):
            found.append(NonFinite(name, len(places), tuple(places[0].tolist())))
    return found
