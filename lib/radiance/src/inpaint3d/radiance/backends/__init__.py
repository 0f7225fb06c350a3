"""The heavy operations of a field, in four versions with the same signatures.

`reference` is readable torch and the truth; `native` holds the CPU's kernels, where they are installed; `triton` those
for GPUs; `compiled` is the reference through torch.compile, on accelerators where that works.
"""

import importlib
from collections.abc import Sequence
from functools import cache
from typing import Any, Literal, Protocol, cast, get_args, runtime_checkable

import torch
from torch import Tensor

from inpaint3d.radiance.backends import reference
from inpaint3d.radiance.backends.reference import AdamStep, Cells, Level

__all__ = ["AdamStep", "Backend", "Cells", "Level", "Name", "name_of", "select"]

Name = Literal["reference", "native", "triton", "compiled"]


@runtime_checkable
class Backend(Protocol):
    """What all modules offer; shapes and meaning are documented in `reference`."""

    __name__: str

    @staticmethod
    def hash_encode(points: Tensor, table: Tensor, levels: Sequence[Level]) -> Tensor: ...
    @staticmethod
    def mlp(x: Tensor, weights: Sequence[Tensor], starts: Tensor | None = None) -> Tensor: ...
    @staticmethod
    def colours(
        diffuse: Tensor, specular: Tensor | None, exposure: Tensor | None, specular_scale: float = 1.0
    ) -> tuple[Tensor, Tensor]: ...
    @staticmethod
    def grid_histogram(cells: Cells, origins: Tensor, directions: Tensor, tdist: Tensor, floor: float) -> Tensor: ...
    @staticmethod
    def grid_learn(density: Tensor, side: int, cube: Tensor, seen: Tensor, memory: float) -> None: ...
    @staticmethod
    def composite(density: Tensor, rgb: Tensor, tdist: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]: ...
    @staticmethod
    def resample(sdist: Tensor, weights: Tensor, count: int, jitter: Tensor | None = None) -> Tensor: ...
    @staticmethod
    def unit_cube(points: Tensor, contraction: bool, bound: float) -> Tensor: ...
    @staticmethod
    def interlevel(ends: Tensor, weights: Tensor, other_ends: Tensor, other_weights: Tensor) -> Tensor: ...
    @staticmethod
    def adam_step(param: Tensor, grad: Tensor, m: Tensor, v: Tensor, how: AdamStep) -> int | Tensor: ...


def select(device: torch.device | str, backend: Name | None = None) -> Backend:
    """The module that computes on `device`: `backend` where it is named, else native on a CPU that has it, triton or
    compiled on an accelerator for which this machine can compile, and otherwise the reference.

    Raises ImportError where "native" or "triton" is asked for and is not installed, ValueError for any other name.
    """
    if backend not in (None, *get_args(Name)):
        raise ValueError(f"backend {backend!r} is unknown; use one of {', '.join(get_args(Name))}")
    return _load(backend, torch.device(device).type)


@cache
def _load(backend: Name | None, device_type: str) -> Backend:
    if backend is not None:
        return cast(Backend, importlib.import_module(f"{__name__}.{backend}"))
    for name in ("native",) if device_type == "cpu" else ("triton", "compiled"):
        try:
            module: Any = importlib.import_module(f"{__name__}.{name}")
        except ImportError:
            continue
        if name == "native" or module.can_compile(device_type):
            return cast(Backend, module)
    return cast(Backend, reference)


def name_of(module: Backend) -> Name:
    """The name that `select` knows a module by."""
    return cast(Name, module.__name__.rpartition(".")[2])
