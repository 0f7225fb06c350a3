"""The container of binary glTF 2.0: a JSON document and the bytes that it speaks of, in one file."""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942


def write_glb_file(path: Path, document: Mapping[str, Any], body: bytes) -> None:
    """Write a document whose only buffer is `body`, of a length that 4 divides. Equal contents give equal bytes."""
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    header = struct.pack("<III", _MAGIC, 2, 12 + 8 + len(text) + 8 + len(body))
    parts = [header, struct.pack("<II", len(text), _JSON), text, struct.pack("<II", len(body), _BIN), body]
    path.write_bytes(b"".join(parts))
