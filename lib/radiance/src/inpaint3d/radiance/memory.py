"""Memory for large tables.

Random reads of a large table in small pages wait for addresses to be translated before they wait for data; and a
gradient that is allocated anew in each step costs a page fault for each 4 KiB: 0.3 s a step for the paper's tables.
"""

import sys

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.weak import WeakIdKeyDictionary

# References to an array without a tensor on it: the list's, the loop's, and that of getrefcount itself.
UNUSED = 3


def allocate_like(like: Tensor) -> Tensor:
    """Memory of a tensor's shape, not initialised, in huge pages where it is large: numpy asks the system for them."""
    if like.dtype != torch.float32 or like.device.type != "cpu":
        return torch.empty_like(like)
    return torch.from_numpy(np.empty(tuple(like.shape), np.float32))


class GradientMemory:
    """Memory for the gradients of tables, used again once nothing refers to it, and freed with its table."""

    def __init__(self) -> None:
        self._arrays: WeakIdKeyDictionary = WeakIdKeyDictionary()

    def take(self, table: Tensor) -> Tensor:
        """Memory of the table's shape that no living tensor uses; not initialised."""
        if table not in self._arrays:
            self._arrays[table] = []
        arrays: list[NDArray[np.float32]] = self._arrays[table]
        for array in arrays:
            if sys.getrefcount(array) == UNUSED:
                return torch.from_numpy(array)
        arrays.append(np.empty(tuple(table.shape), np.float32))
        return torch.from_numpy(arrays[-1])
