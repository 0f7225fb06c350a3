"""What is saved: a mask request in YAML, as a person would write it."""

from pathlib import Path
from typing import Any

import yaml

from inpaint3d.contracts.models.artifacts import MaskRequest
from inpaint3d.contracts.models.documents import load_document

HEADER = "# Made on the page of `inpaint3d masks edit`, which opens it again.\n"


def write_request(path: Path, request: MaskRequest) -> None:
    """Write a request as YAML, whole or not at all."""
    document = _put_kind_first(request.model_dump(mode="json", exclude_defaults=True))
    path.parent.mkdir(parents=True, exist_ok=True)
    staged = path.with_name(f".{path.name}.new")
    staged.write_text(HEADER + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110))
    staged.replace(path)


def read_request(path: Path) -> MaskRequest | None:
    """The request that was saved before; None where there is none. ConfigurationError names what is wrong in it."""
    return load_document(path, MaskRequest)[0] if path.is_file() else None


def _put_kind_first(value: Any) -> Any:
    """What a mapping is of before what is in it, as people write it."""
    if isinstance(value, list):
        return [_put_kind_first(item) for item in value]
    if not isinstance(value, dict):
        return value
    return {name: _put_kind_first(value[name]) for name in sorted(value, key=lambda name: name != "kind")}
