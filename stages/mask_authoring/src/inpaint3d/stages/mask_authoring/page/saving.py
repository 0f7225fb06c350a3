"""What is saved: a mask request in YAML, as a person would write it."""

from pathlib import Path

import yaml

from inpaint3d.contracts.models.artifacts import MaskRequest
from inpaint3d.contracts.models.documents import load_document

HEADER = "# Made on the page of `inpaint3d masks edit`, which opens it again.\n"


def write_request(path: Path, request: MaskRequest) -> None:
    """Write a request as YAML, whole or not at all."""
    document = request.model_dump(mode="json", exclude_defaults=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    staged = path.with_name(f".{path.name}.new")
    staged.write_text(HEADER + yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=110))
    staged.replace(path)


def read_request(path: Path) -> MaskRequest | None:
    """The request that was saved before; None where there is none. ConfigurationError names what is wrong in it."""
    return load_document(path, MaskRequest)[0] if path.is_file() else None
