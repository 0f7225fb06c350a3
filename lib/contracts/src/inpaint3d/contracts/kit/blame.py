"""Whose fault an exception of a stage's method is: the machine's, the data's, or the code's.

Readers are functions that are given a file. A `KeyError` that comes out of one which was given a file of an input says
that the file is not what it should be; the same error anywhere else is a bug.
"""

import struct
import traceback
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import FrameType

from pydantic import ValidationError

from inpaint3d.contracts.errors import BadInputError, Inpaint3dError, find_os_error
from inpaint3d.contracts.models.manifest import first_error
from inpaint3d.contracts.store import Artifact

_UNREADABLE = (
    ValueError, LookupError, TypeError, AttributeError, OverflowError, EOFError, RecursionError,
    struct.error, zlib.error, zipfile.BadZipFile,
)  # fmt: skip
_READERS = ("safetensors",)
"""Packages whose own exceptions say that a file cannot be read."""
RAW = "raw"
"""Where an artifact keeps files of somebody else's, under their own names."""


def find_fault(error: Exception, opened: Mapping[str, Path]) -> Inpaint3dError | None:
    """The tree's word for an exception that is the machine's or an input's fault; None where it is a bug.

    opened: port -> folder of an artifact that the stage read.
    """
    if (machine := find_os_error(error)) is not None:
        return machine
    if not isinstance(error, _UNREADABLE) and not type(error).__module__.startswith(_READERS):
        return None
    for given in _list_arguments(error):
        if (place := _name_file(given, error, opened)) is not None:
            what = first_error(error) if isinstance(error, ValidationError) else f"{type(error).__name__}: {error}"
            return BadInputError(f"{place} cannot be read ({what:.300}); repair or replace it and run again")
    return None


def _list_arguments(error: Exception) -> Iterator[object]:
    """What the functions that the exception came through were given, the innermost first."""
    frames: list[FrameType] = [frame for frame, _ in traceback.walk_tb(error.__traceback__)]
    for frame in reversed(frames):
        code = frame.f_code
        for name in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]:
            yield frame.f_locals.get(name)


def _name_file(given: object, error: Exception, opened: Mapping[str, Path]) -> str | None:
    """`port: file`, where a function was given a file or folder of an input, or the artifact whose data is invalid."""
    if isinstance(given, Artifact) and isinstance(error, ValidationError):
        given = given.root
    if not isinstance(given, str | Path):
        return None
    path = Path(given)
    for port, root in opened.items():
        if path.is_relative_to(root) or path.is_relative_to(root.resolve()):
            inside = path.relative_to(root if path.is_relative_to(root) else root.resolve())
            own = inside.relative_to(RAW) if inside.parts[:1] == (RAW,) else inside
            return f"{port}: {own}" if own.parts else f"input {port}"
    return None
