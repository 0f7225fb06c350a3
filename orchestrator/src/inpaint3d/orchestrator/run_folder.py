"""One run folder, one owner: `runs/NAME/.lock` is held for as long as a run of the name lasts."""

import contextlib
import datetime
import fcntl
import json
import os
import platform
import sys
from collections.abc import Generator
from pathlib import Path
from typing import TextIO

from inpaint3d.contracts.errors import ConfigurationError, RetryableError
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.plan import Planner

LOCK = ".lock"


@contextlib.contextmanager
def own_folder(folder: Path, *, wait: bool = False) -> Generator[None]:
    """Hold a run's folder, which is made; the lock dies with its holder.

    RetryableError where another run holds it, which is named; with `wait`, it is waited for instead.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (FileExistsError, NotADirectoryError) as error:
        raise ConfigurationError(f"--runs-dir: {folder} is no folder; move it away, or give another --name") from error
    with _open_lock(folder / LOCK) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = _read_holder(folder / LOCK)
            if not wait:
                raise RetryableError(
                    f"{folder} is held by another run ({holder}); give another --name, or --wait for its end"
                ) from error
            sys.stderr.write(f"{folder}: waiting for the run that holds it ({holder})\n")
            fcntl.flock(file, fcntl.LOCK_EX)
        _write_holder(file)
        yield


def check_capture(planner: Planner, *, replace: bool) -> None:
    """ConfigurationError where the last run of the planner's name was of another capture, and is not to be replaced."""
    for record in planner.history.of(planner.name):
        before, now = record.externals.get("capture"), planner.externals["capture"]
        if before is None or before == now or replace:
            return
        raise ConfigurationError(
            f"--name {planner.name}: its last run ({record.started[:19]}) was of another capture "
            f"({before[7:19]}, this is {now[7:19]}); give --name OTHER, or --replace its results "
            "(after adding a photo, for example)"
        )


def _open_lock(path: Path) -> TextIO:
    """The lock's file; what else lies in its place, a dangling link for example, is removed."""
    if path.is_symlink() or path.is_dir():
        remove(path)
    return os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666), "r+")


def _read_holder(path: Path) -> str:
    try:
        return "process {pid} on {host}, since {since}".format_map(json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError):  # it has just begun
        return "which has just begun"


def _write_holder(file: TextIO) -> None:
    now = datetime.datetime.now(datetime.UTC)
    holder = {"pid": os.getpid(), "host": platform.node(), "since": f"{now:%Y-%m-%d %H:%M:%S} UTC"}
    file.seek(0)
    file.truncate()
    file.write(json.dumps(holder) + "\n")
    file.flush()
