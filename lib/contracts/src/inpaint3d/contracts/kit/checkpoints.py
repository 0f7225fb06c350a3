"""Checkpoints as safe as artifacts: sealed by a hash of every byte, on the disk before they are seen, two generations.

A checkpoint is a safetensors file. Its seal is a sha256 in the header, taken over the file with 64 zeros in its place,
so that one file that appears whole carries its own proof, wherever it is copied to.
"""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from inpaint3d.contracts.models.canonical import CHUNK
from inpaint3d.contracts.store.workspace import fsync, note, remove

OPEN_SEAL = {"sha256": "0" * 64}
"""What a checkpoint is to be written with as its metadata: `save_file(tensors, path, metadata=OPEN_SEAL)`."""
_ZEROS = OPEN_SEAL["sha256"].encode()
_LENGTH = 8
_LONGEST_HEADER = 100_000_000  # of the format


def write_checkpoint(path: Path, write: Callable[[Path], None]) -> None:
    """Have a checkpoint written beside `path`, seal it, and put it there; the one before it is kept besides."""
    staged = path.with_suffix(".new")
    write(staged)
    _seal_path(staged)
    fsync(staged)
    if path.is_file():
        path.replace(previous_of(path))
    staged.replace(path)
    fsync(path.parent)


def find_checkpoint(path: Path) -> Path | None:
    """The newest generation that is whole; None where there is none. What is damaged is said and removed."""
    for candidate in (path, previous_of(path)):
        if is_sealed(candidate):
            return candidate
        if candidate.exists() or candidate.is_symlink():
            note(f"{candidate} is damaged: what it was the checkpoint of goes on from an earlier one, or starts anew")
            remove(candidate)
    return None


def previous_of(path: Path) -> Path:
    """Where the generation before the newest lies."""
    return path.with_suffix(f".previous{path.suffix}")


def is_sealed(path: Path) -> bool:
    """Whether a file is a checkpoint, and each of its bytes what was written."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        found = _find_seal(file)
        if found is None:
            return False
        at, seal = found
        return seal.decode("ascii", "replace") == _digest_unsealed(file, at)


def _seal_path(path: Path) -> None:
    with path.open("r+b") as file:
        found = _find_seal(file)
        if found is None:
            raise ValueError(f"{path} was not written with OPEN_SEAL as its metadata")
        digest = _digest_unsealed(file, found[0])
        file.seek(found[0])
        file.write(digest.encode())


def _find_seal(file: BinaryIO) -> tuple[int, bytes] | None:
    """Where in the file the seal's digits begin, and what they are."""
    length = int.from_bytes(file.read(_LENGTH), "little")
    if not 0 < length < _LONGEST_HEADER:
        return None
    header = file.read(length)
    try:
        seal = json.loads(header)["__metadata__"]["sha256"].encode()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None
    at = header.find(b'"' + seal + b'"')
    return (_LENGTH + at + 1, seal) if at >= 0 and len(seal) == len(_ZEROS) else None


def _digest_unsealed(file: BinaryIO, at: int) -> str:
    """sha256 of a file with zeros for its seal."""
    sha = hashlib.sha256()
    file.seek(0)
    sha.update(file.read(at) + _ZEROS)
    file.seek(at + len(_ZEROS))
    while chunk := file.read(CHUNK):
        sha.update(chunk)
    return sha.hexdigest()
