"""Compiled templates, kept beside the compiled modules: the report's take a seventh of a run that does nothing."""

import contextlib
import hashlib
import os
from pathlib import Path

from jinja2 import BytecodeCache
from jinja2.bccache import Bucket

_SEAL = hashlib.sha256().digest_size


class TemplateBytecode(BytecodeCache):
    """A file for each template, like Python's own `.pyc`; jinja2 takes none of another version or another source.

    A folder that cannot be written, or a file that cannot be read, costs the time of compiling and nothing else.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def load_bytecode(self, bucket: Bucket) -> None:
        """Fill a template's bucket from its file, where there is one."""
        try:
            content = self._place(bucket).read_bytes()
        except OSError:
            return
        # Of a flipped bit Python's own format knows nothing.
        if hashlib.sha256(content[_SEAL:]).digest() == content[:_SEAL]:
            bucket.bytecode_from_string(content[_SEAL:])

    def dump_bytecode(self, bucket: Bucket) -> None:
        """Write a template's file; it appears whole."""
        place, content = self._place(bucket), bucket.bytecode_to_string()
        staged = place.with_suffix(f".{os.getpid()}")
        with contextlib.suppress(OSError):
            place.parent.mkdir(exist_ok=True)
            staged.write_bytes(hashlib.sha256(content).digest() + content)
            staged.replace(place)

    def _place(self, bucket: Bucket) -> Path:
        return self._folder / f"{bucket.key}.jinja"
