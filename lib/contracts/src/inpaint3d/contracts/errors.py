"""One exception tree, and the exit code that each branch leaves behind.

    Inpaint3dError                1   a bug, or an error nobody foresaw
    ├── NonFiniteError            1   numbers of a fit are not finite, and no input is to blame
    ├── ConfigurationError        2   a parameter, pipeline.yaml, stage.yaml or request is wrong
    ├── BadInputError             3   the data cannot work, or an artifact is not what its schema says
    │   └── ArtifactError             an artifact is missing, damaged or malformed
    ├── WaitingError              4   a person has to do something first (author a mask)
    ├── StorageError              5   the disk is full or fails, or the store cannot be written
    ├── DoubtfulError             6   a result is there, but its own figures say that it cannot be right
    ├── RetryableError           75   try again: the same inputs may work (sysexits EX_TEMPFAIL)
    └── InterruptedRun          143   stopped by SIGTERM or SIGINT; work so far is kept

Nothing ever parses a log to learn what went wrong.
"""

import errno
import os
from collections.abc import Sequence
from typing import ClassVar


class Inpaint3dError(Exception):
    """Says what, with values, and how to repair it."""

    exit_code: ClassVar[int] = 1
    kind: ClassVar[str] = "internal error"


class NonFiniteError(Inpaint3dError):
    kind = "not finite"


class ConfigurationError(Inpaint3dError):
    exit_code = 2
    kind = "configuration"


class BadInputError(Inpaint3dError):
    exit_code = 3
    kind = "bad input"


class ArtifactError(BadInputError):
    kind = "bad artifact"


class WaitingError(Inpaint3dError):
    exit_code = 4
    kind = "waiting"


class StorageError(Inpaint3dError):
    exit_code = 5
    kind = "storage"


class DoubtfulError(Inpaint3dError):
    """`doubts`: why the result cannot be right, each with its figures and the repair."""

    exit_code = 6
    kind = "doubtful"

    def __init__(self, doubts: Sequence[str]) -> None:
        super().__init__(f"{'; '.join(doubts)}. The result is kept: --accept-doubtful goes on with it")


class RetryableError(Inpaint3dError):
    exit_code = 75
    kind = "retryable"


class InterruptedRun(Inpaint3dError):
    exit_code = 143
    kind = "stopped"


EXIT_CODES: dict[int, str] = {
    c.exit_code: c.kind
    for c in (
        Inpaint3dError, ConfigurationError, BadInputError, WaitingError, StorageError, DoubtfulError, RetryableError,
        InterruptedRun,
    )
}  # fmt: skip
"""Exit code -> what it means."""

MEANINGS: dict[str, str] = {
    "1": "a bug, or an error nobody foresaw; its log has the traceback",
    "2": "a parameter is unknown or out of range",
    "3": "bad input - an artifact is missing, damaged, or not what its schema says",
    "5": "storage - the disk is full or the store cannot be written",
    "6": "doubtful - the result is kept, but its figures say that it cannot be right; --accept-doubtful goes on",
    "75": "retryable - the same inputs may work another time: the bucket did not answer, for example",
    "143": "stopped",
}
"""What every stage's exit codes mean, where its stage.yaml does not say more."""

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)
_TOO_MANY_FILES = (errno.EMFILE, errno.ENFILE)
_NO_FOLDER = (errno.ENOTDIR, errno.EISDIR, errno.ELOOP)
_NO_ANSWER = (errno.ESTALE, errno.ETIMEDOUT, errno.EAGAIN)


def from_os_error(error: OSError) -> Inpaint3dError:
    """The tree's word for an operating system error met while reading or writing artifacts."""
    where = error.filename2 or error.filename or "the store"  # of a copy, the file that could not be written
    if error.errno in _DISK_FULL:
        return StorageError(f"no space left writing {where}; free some (inpaint3d gc helps) and run again")
    if error.errno == errno.EROFS:
        return StorageError(f"{where} lies on a read-only file system; mount it writable, or give another --store")
    if error.errno in _READ_ONLY:
        return StorageError(f"no access to {where}: {error.strerror}; check its permissions")
    if error.errno == errno.EIO:
        return StorageError(f"the disk failed at {where}: {error.strerror}; check it, then `inpaint3d verify --repair`")
    if error.errno in _TOO_MANY_FILES:
        return RetryableError(f"too many open files at {where}: {error.strerror}; raise `ulimit -n` and run again")
    if error.errno in _NO_FOLDER:
        return StorageError(f"{where}: {error.strerror}; move away what is in its place and run again")
    if error.errno in _NO_ANSWER:
        return RetryableError(f"{where}: {error.strerror}; run again when its file system answers")
    return Inpaint3dError(f"{where}: {error.strerror or error}")


def find_os_error(error: BaseException) -> Inpaint3dError | None:
    """The tree's word for an error of the machine behind an exception: in its chain, or told by its text alone.

    Libraries in other languages say what the system said in words: `No space left on device (os error 28)`.
    """
    link: BaseException | None = error
    while link is not None:
        if isinstance(link, MemoryError):
            return RetryableError("no memory left; give the machine more, or run fewer stages at once, and run again")
        number = link.errno if isinstance(link, OSError) else _find_number(str(link))
        if number is not None:
            found = link if isinstance(link, OSError) else OSError(number, os.strerror(number))
            if (known := from_os_error(found)).exit_code != Inpaint3dError.exit_code:
                return known
        link = link.__cause__ or link.__context__
    return None


def _find_number(text: str) -> int | None:
    told = (*_DISK_FULL, errno.EROFS, errno.EIO, *_TOO_MANY_FILES)
    return next((number for number in told if os.strerror(number) in text), None)
