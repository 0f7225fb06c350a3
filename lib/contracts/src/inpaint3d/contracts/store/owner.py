"""Who left something in a shared store: a process, of one boot of one machine, that may be gone."""

import functools
import hashlib
import os
import platform
from pathlib import Path
from typing import NamedTuple


class Owner(NamedTuple):
    """A process. A number of one means something on its machine alone, until the next boot, in its own namespace."""

    host: str
    boot: str
    namespace: str
    pid: int

    def __str__(self) -> str:
        return f"{self.host}.{self.boot}.{self.namespace}.{self.pid}"

    @property
    def is_gone(self) -> bool:
        """Whether it is known to be dead. Of another machine or namespace nothing is known: it may be at work."""
        here = this_process()
        if self.host != here.host:
            return False
        if self.boot != here.boot:
            return True
        return self.namespace == here.namespace and not _is_alive(self.pid)


def this_process() -> Owner:
    """The process that asks."""
    return Owner(*_identify_machine(), os.getpid())


def parse_owner(text: str) -> Owner | None:
    """The owner that a text names, as `str` wrote it; None where it names none."""
    parts = text.split(".")
    if len(parts) != 4 or not parts[3].isdigit():
        return None
    return Owner(parts[0], parts[1], parts[2], int(parts[3]))


@functools.cache
def _identify_machine() -> tuple[str, str, str]:
    return (
        _shorten(platform.node()),
        _shorten(_read("/proc/sys/kernel/random/boot_id")),
        _shorten(_read_link("/proc/self/ns/pid")),
    )


def _shorten(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _read(path: str) -> str:
    try:
        return Path(path).read_text()
    except OSError:  # no Linux: every boot looks like the same one
        return ""


def _read_link(path: str) -> str:
    try:
        return str(Path(path).readlink())
    except OSError:
        return ""


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:  # somebody else's
        return True
    return True
