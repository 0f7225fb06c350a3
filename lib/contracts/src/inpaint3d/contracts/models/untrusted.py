"""Text that somebody else wrote: YAML and JSON read within bounds of size, depth and growth.

What is wrong is one UntrustedError that says where and what; who reads the file says whose it is. Pictures are bounded
where they are decoded (`inpaint3d.scene.pixel_io`), arrays by `read_safetensors_header`.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import yaml

# libyaml's, ten times as fast, where PyYAML was built with it; both read the same YAML.
LOADER = cast(type[yaml.SafeLoader], getattr(yaml, "CSafeLoader", yaml.SafeLoader))
Location = tuple[int | str, ...]
Lines = dict[Location, int]

MAX_YAML_BYTES = 16 * 2**20
MAX_JSON_BYTES = 256 * 2**20
MAX_DEPTH = 64
"""Of lists and mappings in each other; libyaml ends the process at some tens of thousands."""
MAX_NODES = 1_000_000
"""With every alias written out: nine lines of nine aliases each are a thousand million."""
_UNREADABLE = (ValueError, TypeError, AttributeError, ArithmeticError, LookupError, RecursionError)
_LENGTH_BYTES = 8
_MAX_HEADER_BYTES = 100_000_000  # of the format
_BITS = {
    "BOOL": 8, "U8": 8, "I8": 8, "F8_E4M3": 8, "F8_E5M2": 8, "U16": 16, "I16": 16, "F16": 16, "BF16": 16,
    "U32": 32, "I32": 32, "F32": 32, "U64": 64, "I64": 64, "F64": 64,
}  # fmt: skip


class UntrustedError(ValueError):
    """What is wrong, and in which line (from 1) where that is known."""

    def __init__(self, what: str, line: int | None = None) -> None:
        super().__init__(what)
        self.line = line


def read_bounded(path: Path, limit: int) -> bytes:
    """A file's bytes; UntrustedError where there are more than `limit`, which are then not read. OSError as usual."""
    with path.open("rb") as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise UntrustedError(f"larger than {limit // 2**20} MiB; a file of this kind is much smaller")
    return data


def parse_yaml(text: str) -> tuple[Any, Lines]:
    """A document's value, and the line (from 1) of every key and item in it. Raises UntrustedError."""
    _check_events(text)
    try:
        loader = cast(Any, LOADER(text))
        node = cast(yaml.Node | None, loader.get_single_node())
        lines: Lines = {}
        if node is None:
            return None, {(): 1}
        _index_lines(node, (), lines)
        return loader.construct_document(node), lines
    except yaml.YAMLError as error:
        raise _explain(error) from error
    except UntrustedError:
        raise
    except _UNREADABLE as error:  # of a tag or a date that its text does not fit: `!!int x`, 2026-13-01
        raise UntrustedError(f"a value cannot be read as what it is marked as ({error})") from error


def parse_yaml_documents(text: str) -> list[Any]:
    """The values of a stream of documents. Raises UntrustedError."""
    _check_events(text)
    try:
        return list(yaml.load_all(text, Loader=LOADER))
    except yaml.YAMLError as error:
        raise _explain(error) from error
    except _UNREADABLE as error:
        raise UntrustedError(f"a value cannot be read as what it is marked as ({error})") from error


def parse_json(data: bytes) -> Any:
    """A JSON text's value, UTF-8, with or without a byte order mark. Raises UntrustedError."""
    try:
        return json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        raise UntrustedError(f"not valid JSON: {error.msg}", error.lineno) from error
    except RecursionError as error:
        raise UntrustedError("lists or objects in each other, too deep to be read") from error
    except ValueError as error:  # no UTF-8, or a number of more digits than Python converts
        raise UntrustedError(f"cannot be read: {error}") from error


def read_safetensors_header(path: Path) -> dict[str, tuple[str, tuple[int, ...]]]:
    """Name -> (type, shape) of the arrays in a safetensors file, checked against the bytes that are there.

    Raises UntrustedError for a header that lies, before anybody reserves the memory that it asks for.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        header, length = _read_header(file, size)
    described = {name: entry for name, entry in header.items() if name != "__metadata__"}
    arrays = {name: _describe_array(name, entry) for name, entry in described.items()}
    end = 0
    for name, array in sorted(arrays.items(), key=lambda item: item[1].span):
        if array.span[0] != end:
            raise UntrustedError(
                f"its array {name!r:.80} begins at byte {array.span[0]}, not where the last ended ({end})"
            )
        end = array.span[1]
    if end != size - _LENGTH_BYTES - length:
        raise UntrustedError(f"its arrays are said to take {end} bytes, but {size - _LENGTH_BYTES - length} are there")
    return {name: (array.kind, array.shape) for name, array in arrays.items()}


class _Array(NamedTuple):
    kind: str
    shape: tuple[int, ...]
    span: tuple[int, int]


def _read_header(file: BinaryIO, size: int) -> tuple[dict[str, Any], int]:
    length = int.from_bytes(file.read(_LENGTH_BYTES), "little")
    if not 0 < length <= min(_MAX_HEADER_BYTES, size - _LENGTH_BYTES):
        raise UntrustedError(f"no safetensors: its header would have {length} of its {size} bytes")
    header = parse_json(file.read(length))
    if not isinstance(header, dict):
        raise UntrustedError("no safetensors: its header is no JSON object")
    return cast(dict[str, Any], header), length


def _describe_array(name: str, entry: Any) -> _Array:
    try:
        kind, shape, (begin, end) = str(entry["dtype"]), tuple(entry["shape"]), entry["data_offsets"]
        lies = not all(type(n) is int and n >= 0 for n in (*shape, begin, end))
        lies = lies or end - begin != math.prod(shape) * _BITS[kind] // 8
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise UntrustedError(f"no safetensors: its array {name!r:.80} is not described ({error!r:.80})") from error
    if lies:
        raise UntrustedError(f"its array {name!r:.80} is said to be {kind} {shape!r:.80}, which its bytes are not")
    return _Array(kind, shape, (begin, end))


def _check_events(text: str) -> None:
    """Depth and growth, from events: the only part of YAML that needs neither recursion nor memory."""
    if len(text) > MAX_YAML_BYTES:
        raise UntrustedError(f"larger than {MAX_YAML_BYTES // 2**20} MiB")
    sizes: dict[str, int] = {}
    open_nodes: list[tuple[str | None, int]] = []
    nodes = 0
    try:
        for event in _parse_events(text):
            line = event.start_mark.line + 1
            if isinstance(event, yaml.AliasEvent):
                if event.anchor not in sizes:
                    raise UntrustedError(f"*{event.anchor} stands for what it is inside of, or for nothing", line)
                nodes += sizes[event.anchor]
            elif isinstance(event, yaml.ScalarEvent):
                nodes += 1
                if event.anchor:
                    sizes[event.anchor] = 1
            elif isinstance(event, yaml.CollectionStartEvent):
                sizes.pop(event.anchor or "", None)
                open_nodes.append((event.anchor, nodes))
                nodes += 1
            elif isinstance(event, yaml.CollectionEndEvent):
                anchor, before = open_nodes.pop()
                if anchor:
                    sizes[anchor] = nodes - before
            if len(open_nodes) > MAX_DEPTH:
                raise UntrustedError(f"more than {MAX_DEPTH} lists or mappings in each other", line)
            if nodes > MAX_NODES:
                raise UntrustedError(f"more than {MAX_NODES} values, with its aliases written out", line)
    except yaml.YAMLError as error:
        raise _explain(error) from error


def _parse_events(text: str) -> Iterator[Any]:
    return cast(Iterator[Any], yaml.parse(text, Loader=LOADER))


def _index_lines(node: yaml.Node, at: Location, lines: Lines) -> None:
    lines[at] = node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        for key, value in cast(list[tuple[yaml.Node, yaml.Node]], node.value):
            line = key.start_mark.line + 1
            if not isinstance(key, yaml.ScalarNode):
                raise UntrustedError("a list or mapping stands where the name of a value has to", line)
            name = str(key.value)
            if (*at, name) in lines:
                raise UntrustedError(f"{name} stands here twice", line)
            _index_lines(value, (*at, name), lines)
            lines[(*at, name)] = line
    elif isinstance(node, yaml.SequenceNode):
        for i, value in enumerate(cast(list[yaml.Node], node.value)):
            _index_lines(value, (*at, i), lines)


def _explain(error: yaml.YAMLError) -> UntrustedError:
    # What is never closed is noticed at the end of the file; the line to repair is where it was opened.
    mark = getattr(error, "context_mark", None) or getattr(error, "problem_mark", None)
    problem = ", ".join(str(p) for n in ("context", "problem") if (p := getattr(error, n, None))) or error
    return UntrustedError(f"not valid YAML: {problem}", mark.line + 1 if mark else None)
