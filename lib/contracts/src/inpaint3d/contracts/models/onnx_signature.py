"""What an ONNX file takes and gives, read from the file alone: no runtime, and no weight, is loaded.

Of its protocol buffers (onnx.proto) only the graph's inputs, outputs and where its weights lie are looked at; the rest
is passed over, so that a file of gigabytes takes milliseconds.
"""

import mmap
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from inpaint3d.contracts.models.untrusted import UntrustedError

# Field numbers of onnx.proto.
_MODEL_GRAPH = 7
_GRAPH_INITIALIZER, _GRAPH_INPUT, _GRAPH_OUTPUT = 5, 11, 12
_TENSOR_NAME, _TENSOR_EXTERNAL = 8, 13
_VALUE_NAME, _VALUE_TYPE, _TYPE_TENSOR, _TENSOR_SHAPE, _SHAPE_DIMENSION, _DIMENSION_VALUE = 1, 2, 1, 2, 1, 1
_ENTRY_KEY, _ENTRY_VALUE = 1, 2

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5  # wire types
_MAX_VALUES = 10_000  # inputs, outputs, dimensions of one of them
_MAX_NAME = 1000

Span = tuple[int, int]
Shape = tuple[int | None, ...]
"""None: any length."""


class OnnxSignature(NamedTuple):
    """Inputs and outputs by name, and the names of the files that hold weights."""

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]
    external: tuple[str, ...]


def read_onnx_signature(path: Path) -> OnnxSignature:
    """What an ONNX file takes and gives. UntrustedError for a file that is none; OSError as usual."""
    with path.open("rb") as file:
        try:
            mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError as error:
            raise UntrustedError("it is empty") from error
        with mapped:
            return _read_model(mapped)


def _read_model(data: mmap.mmap) -> OnnxSignature:
    graphs = [span for number, span in _list_fields(data, (0, len(data))) if number == _MODEL_GRAPH]
    if len(graphs) != 1:
        raise UntrustedError("no ONNX file: it holds no graph")
    inputs: dict[str, Shape] = {}
    outputs: dict[str, Shape] = {}
    weights: set[str] = set()
    external: dict[str, None] = {}
    for number, span in _list_fields(data, graphs[0]):
        if number in (_GRAPH_INPUT, _GRAPH_OUTPUT):
            name, shape = _read_value(data, span)
            (inputs if number == _GRAPH_INPUT else outputs)[name] = shape
        elif number == _GRAPH_INITIALIZER:
            name, place = _read_initializer(data, span)
            weights.add(name)
            external |= {place: None} if place is not None else {}
    # Old files list their weights among the inputs.
    return OnnxSignature({n: s for n, s in inputs.items() if n not in weights}, outputs, tuple(external))


def _read_value(data: mmap.mmap, span: Span) -> tuple[str, Shape]:
    """Name and shape of a ValueInfoProto."""
    name = ""
    shape: list[int | None] = []
    for number, part in _list_fields(data, span):
        if number == _VALUE_NAME:
            name = _read_text(data, part)
        elif number == _VALUE_TYPE:
            for tensor in _find(data, part, _TYPE_TENSOR):
                for dimensions in _find(data, tensor, _TENSOR_SHAPE):
                    shape += [_read_dimension(data, d) for d in _find(data, dimensions, _SHAPE_DIMENSION)]
        if len(shape) > _MAX_VALUES:
            raise UntrustedError(f"its value {name!r:.80} has more than {_MAX_VALUES} dimensions")
    return name, tuple(shape)


def _read_dimension(data: mmap.mmap, span: Span) -> int | None:
    lengths = [start for number, (start, end) in _list_fields(data, span) if number == _DIMENSION_VALUE and end < start]
    return None if not lengths else _read_varint(data, lengths[-1], span[1])[0]


def _read_initializer(data: mmap.mmap, span: Span) -> tuple[str, str | None]:
    """Name of a TensorProto, and the file that holds its values where it does not."""
    name, place = "", None
    for number, part in _list_fields(data, span):
        if number == _TENSOR_NAME:
            name = _read_text(data, part)
        elif number == _TENSOR_EXTERNAL:
            key, value = (
                "".join(_read_text(data, text) for text in _find(data, part, n)) for n in (_ENTRY_KEY, _ENTRY_VALUE)
            )
            place = value if key == "location" else place
    return name, place


def _find(data: mmap.mmap, span: Span, wanted: int) -> list[Span]:
    """The messages and strings of one field number."""
    return [part for number, part in _list_fields(data, span) if number == wanted and part[0] <= part[1]]


def _list_fields(data: mmap.mmap, span: Span) -> Iterator[tuple[int, Span]]:
    """Field number and place of what a message holds; of numbers the place's end lies before its start."""
    at, end = span
    while at < end:
        tag, at = _read_varint(data, at, end)
        number, wire = tag >> 3, tag & 7
        if wire == _BYTES:
            length, at = _read_varint(data, at, end)
            part, after = (at, at + length), at + length
        elif wire == _VARINT:
            part, after = (at, -1), _read_varint(data, at, end)[1]
        elif wire in (_FIXED32, _FIXED64):
            after = at + (4 if wire == _FIXED32 else 8)
            part = (at, -1)
        else:
            raise UntrustedError(f"no ONNX file: byte {at} begins nothing that a file of this kind holds")
        if after > end or number == 0:
            raise UntrustedError(f"no ONNX file, or not all of it: what begins at byte {at} does not end in it")
        yield number, part
        at = after


def _read_varint(data: mmap.mmap, at: int, end: int) -> tuple[int, int]:
    """A number in groups of seven bits, and where it ends."""
    value = 0
    for shift in range(0, 70, 7):
        if at >= end:
            break
        byte, at = data[at], at + 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise UntrustedError(f"no ONNX file, or not all of it: the number at byte {at} does not end")


def _read_text(data: mmap.mmap, span: Span) -> str:
    start, end = span
    if end < start or end - start > _MAX_NAME:
        raise UntrustedError(f"no ONNX file: byte {start} begins no name")
    return data[start:end].decode(errors="replace")
