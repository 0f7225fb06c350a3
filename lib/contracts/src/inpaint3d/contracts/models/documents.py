"""YAML documents that people write: read safely, validated by a closed model, errors with file and line."""

from pathlib import Path
from typing import Any, TypeVar, cast

import yaml
from pydantic import BaseModel, ValidationError

from inpaint3d.contracts.errors import ConfigurationError

D = TypeVar("D", bound=BaseModel)
# libyaml's, ten times as fast, where PyYAML was built with it; both read the same YAML.
LOADER = cast(type[yaml.SafeLoader], getattr(yaml, "CSafeLoader", yaml.SafeLoader))
Location = tuple[int | str, ...]


def load_yaml(path: Path) -> tuple[Any, dict[Location, int]]:
    """The document's value, and the line (from 1) of every key and item in it.

    Raises ConfigurationError naming the file and line where it cannot be read or is not YAML.
    """
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        what = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ConfigurationError(f"cannot read {path}: {what}; give a YAML file") from error
    try:
        loader = cast(Any, LOADER(text))
        node = cast(yaml.Node | None, loader.get_single_node())
        lines: dict[Location, int] = {}
        if node is None:
            return None, {(): 1}
        _index(node, (), lines, path)
        return loader.construct_document(node), lines
    except yaml.YAMLError as error:
        # What is never closed is noticed at the end of the file; the line to repair is where it was opened.
        mark = getattr(error, "context_mark", None) or getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        problem = ", ".join(str(p) for n in ("context", "problem") if (p := getattr(error, n, None))) or error
        raise ConfigurationError(f"{path}{line}: not valid YAML: {problem}") from error


def _index(node: yaml.Node, at: Location, lines: dict[Location, int], path: Path) -> None:
    lines[at] = node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        for key, value in cast(list[tuple[yaml.ScalarNode, yaml.Node]], node.value):
            if (*at, key.value) in lines:
                raise ConfigurationError(f"{path}:{key.start_mark.line + 1}: {key.value} stands here twice")
            _index(value, (*at, key.value), lines, path)
            lines[(*at, key.value)] = key.start_mark.line + 1
    elif isinstance(node, yaml.SequenceNode):
        for i, value in enumerate(cast(list[yaml.Node], node.value)):
            _index(value, (*at, i), lines, path)


def line_of(lines: dict[Location, int], at: Location) -> int:
    """The line of a place, or of the nearest thing around it. Tags of unions stand in `at` but not in the document."""
    here: Location = ()
    for part in at:
        if (*here, part) in lines:
            here = (*here, part)
    return lines.get(here, 1)


def load_document(path: Path, model: type[D]) -> tuple[D, dict[Location, int]]:
    """A validated document and its line index. Raises ConfigurationError: `file:line: field: what, got value`."""
    value, lines = load_yaml(path)
    try:
        return model.model_validate(value), lines
    except ValidationError as error:
        reports: list[str] = []
        for e in error.errors(include_url=False):
            at = ".".join(str(p) for p in e["loc"]) or "(whole document)"
            got = "" if e["type"] in ("missing", "extra_forbidden") else f", got {e['input']!r:.80}"
            reports.append(f"{path}:{line_of(lines, e['loc'])}: {at}: {e['msg']}{got}")
        raise ConfigurationError("\n".join(reports)) from error
