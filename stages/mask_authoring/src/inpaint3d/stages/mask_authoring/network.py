"""Somebody else's network, as onnxruntime runs it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError

Array = NDArray[Any]
Shape = tuple[int | None, ...]
"""None: any length."""
TYPES = {
    "tensor(float)": np.float32,
    "tensor(float16)": np.float16,
    "tensor(int32)": np.int32,
    "tensor(int64)": np.int64,
}


class Network:
    """An ONNX file on the processor."""

    def __init__(self, path: Path, threads: int) -> None:
        """BadInputError for a file that onnxruntime cannot run."""
        # Here, and not above: it is large, and only those who name a network need it.
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.log_severity_level = 3  # errors, which are raised too
        self._path = path
        try:
            self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's own exceptions have no common base
            raise BadInputError(f"{path} cannot be run by onnxruntime ({error}); export it again") from error
        self.inputs: dict[str, Shape] = {i.name: _list_lengths(i.shape) for i in self._session.get_inputs()}
        self.outputs = [o.name for o in self._session.get_outputs()]
        self._types = {i.name: i.type for i in self._session.get_inputs()}

    def run(self, given: Mapping[str, Array], wanted: Sequence[str]) -> list[Array]:
        """Outputs by name; what it takes is cast to the types that it wants. BadInputError where it fails."""
        try:
            feed = {n: np.ascontiguousarray(given[n], TYPES[self._types[n]]) for n in self.inputs}
            found: list[Array] = [np.asarray(value) for value in self._session.run(wanted, feed)]
        except Exception as error:
            shapes = ", ".join(f"{name} {list(value.shape)}" for name, value in given.items())
            raise BadInputError(f"{self._path} could not be run on {shapes} ({error}); export it again") from error
        for name, value in zip(wanted, found, strict=True):
            if bad := int((~np.isfinite(value)).sum()):
                raise BadInputError(f"{self._path}: {bad} of {value.size} values of its output {name} are not finite")
        return found


def _list_lengths(shape: Sequence[object]) -> Shape:
    return tuple(n if isinstance(n, int) else None for n in shape)
