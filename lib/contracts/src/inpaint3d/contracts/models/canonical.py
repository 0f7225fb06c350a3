"""One byte string for one value: canonical JSON, and sha256 over files and values."""

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError

CHUNK = 1 << 20
_ENCODER = json.JSONEncoder(sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def canonical_json(value: Any) -> bytes:
    """Sorted keys, no white space, UTF-8, shortest floats; NaN and infinity are refused (RFC 8785 in spirit)."""
    try:
        text = _ENCODER.encode(value)
    except ValueError as error:
        raise ConfigurationError(f"a value cannot be written as JSON ({error}); use finite numbers") from error
    return text.encode()


def digest_of(value: Any) -> str:
    """`sha256:…` of a value's canonical JSON."""
    return "sha256:" + hashlib.sha256(canonical_json(value)).hexdigest()


def file_digest(path: Path) -> str:
    """`sha256:…` of a file's bytes."""
    with path.open("rb") as file:
        return digest_of_chunks(iter(lambda: file.read(CHUNK), b""))


def digest_of_chunks(chunks: Iterable[bytes]) -> str:
    """`sha256:…` of bytes that come piece by piece."""
    sha = hashlib.sha256()
    for chunk in chunks:
        sha.update(chunk)
    return "sha256:" + sha.hexdigest()
