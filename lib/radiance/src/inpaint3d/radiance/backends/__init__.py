"""The heavy operations of a field, in two versions with the same signatures.

`reference` is readable torch and the truth; `native` holds the compiled CPU kernels, where they are installed.
"""

import importlib
from types import ModuleType
from typing import Literal

import torch

Name = Literal["reference", "native"]
OPERATIONS = ("levels_of", "hash_encode", "mlp", "composite", "resample", "adam_step")


def select(device: torch.device | str, backend: Name | None = None) -> ModuleType:
    """The module that computes on `device`: `backend` where it is named, else native on a CPU that has it.

    Raises ImportError where `backend="native"` is asked for and the kernels are not installed, ValueError for a name
    that is neither.
    """
    if backend not in (None, "reference", "native"):
        raise ValueError(f"backend {backend!r} is unknown; use 'reference' or 'native'")
    reference = importlib.import_module("inpaint3d.radiance.backends.reference")
    if backend == "reference" or (backend is None and torch.device(device).type != "cpu"):
        return reference
    try:
        return importlib.import_module("inpaint3d.radiance.backends.native")
    except ImportError:
        if backend == "native":
            raise
        return reference
