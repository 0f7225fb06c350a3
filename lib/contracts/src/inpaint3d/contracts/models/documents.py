"""YAML documents that people write: read safely, validated by a closed model, errors with file and line."""

from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.untrusted import (
    MAX_YAML_BYTES,
    Lines,
    Location,
    UntrustedError,
    parse_yaml,
    read_bounded,
)

D = TypeVar("D", bound=BaseModel)


def load_yaml(path: Path) -> tuple[Any, Lines]:
    """The document's value, and the line (from 1) of every key and item in it.

    Raises ConfigurationError naming the file and line where it cannot be read or is not YAML.
    """
    text = read_document(path)
    try:
        return parse_yaml(text)
    except UntrustedError as error:
        line = f":{error.line}" if error.line is not None else ""
        raise ConfigurationError(f"{path}{line}: {error}") from error


def read_document(path: Path) -> str:
    """The text of a YAML file; ConfigurationError where it cannot be read."""
    try:
        return read_bounded(path, MAX_YAML_BYTES).decode()
    except (OSError, ValueError) as error:
        what = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise ConfigurationError(f"cannot read {path}: {what}; give a YAML file") from error


def line_of(lines: Lines, at: Location) -> int:
    """The line of a place, or of the nearest thing around it. Tags of unions stand in `at` but not in the document."""
    here: Location = ()
    for part in at:
        if (*here, part) in lines:
            here = (*here, part)
    return lines.get(here, 1)


def load_document(path: Path, model: type[D]) -> tuple[D, Lines]:
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
