"""A digest of what the interpreter runs of a Python file: its compiled code without docstrings and line numbers.

Compiling all of the pipeline takes half a second, and each stage's process needs most of it; so a digest is kept beside
what Python itself keeps of the file, in `__pycache__`, and believed on the same grounds: time of change and size.
"""

import ast
import contextlib
import importlib.util
import os
import tempfile
import time
from pathlib import Path
from types import CodeType
from typing import cast

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.canonical import digest_of_chunks

CACHE_TAG = "digest1"
"""Stands in the names of the kept digests; another number for another way to take them."""
SETTLED_NS = 2_000_000_000
"""A file changed less than this ago may change again within one tick of its clock: its digest is not kept."""


def digest_python(path: Path) -> Digest:
    """`sha256:…` of a file's code as this minor version of Python compiles it; equal in every process.

    Comments, blank lines and docstrings do not count. Raises ConfigurationError with the line of what is not Python.
    """
    status = path.stat()
    stamp = f"{status.st_mtime_ns} {status.st_size} "
    kept = Path(importlib.util.cache_from_source(str(path), optimization=CACHE_TAG))
    with contextlib.suppress(OSError):
        if (text := kept.read_text()).startswith(stamp):
            return text.removeprefix(stamp)
    digest = _digest_compiled(path)
    if time.time_ns() - status.st_mtime_ns > SETTLED_NS:
        with contextlib.suppress(OSError):  # a folder that cannot be written in
            _keep(kept, stamp + digest)
    return digest


def _keep(target: Path, text: str) -> None:
    target.parent.mkdir(exist_ok=True)
    descriptor, staged = tempfile.mkstemp(dir=target.parent)
    with os.fdopen(descriptor, "w") as file:
        file.write(text)
    Path(staged).replace(target)


def _digest_compiled(path: Path) -> Digest:
    try:
        tree = ast.parse(path.read_bytes())
    except SyntaxError as error:
        raise ConfigurationError(f"{path}:{error.lineno}: {error.msg}; repair the file") from error
    tree.body = _drop_docstrings(tree.body)
    code = compile(tree, "", "exec", dont_inherit=True, optimize=0)
    return digest_of_chunks([ascii(_describe(code)).encode()])


def _drop_docstrings(body: list[ast.stmt]) -> list[ast.stmt]:
    """The statements, and those inside them, less the bare constants, which do nothing."""
    for statement in body:
        for field in ("body", "orelse", "finalbody"):
            if inner := getattr(statement, field, None):
                setattr(statement, field, _drop_docstrings(inner) or [ast.Pass(lineno=1, col_offset=0)])
        for part in [*getattr(statement, "handlers", ()), *getattr(statement, "cases", ())]:
            part.body = _drop_docstrings(part.body) or [ast.Pass(lineno=1, col_offset=0)]
    return [s for s in body if not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]


def _describe(constant: object) -> object:
    """The same in tuples and literals, whose text is equal for equal code."""
    if isinstance(constant, CodeType):
        return _describe_code(constant)
    if isinstance(constant, frozenset):  # the order of a set differs from process to process
        return "frozenset", sorted(ascii(_describe(item)) for item in cast(frozenset[object], constant))
    if isinstance(constant, tuple):
        return tuple(_describe(item) for item in cast(tuple[object, ...], constant))
    return constant


def _describe_code(code: CodeType) -> tuple[object, ...]:
    """What a code object does, less where it stands: no file name, no line table."""
    arguments = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags)
    names = (code.co_qualname, code.co_names, code.co_varnames, code.co_cellvars, code.co_freevars)
    return arguments, names, code.co_code, code.co_exceptiontable, _describe(code.co_consts)
