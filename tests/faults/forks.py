"""Processes forked from one that has imported what they need, so that a trial costs a fraction of a second."""

import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path


def fork(become: Callable[[], None], stderr: Path, stdout: Path = Path(os.devnull)) -> int:
    """A process in a group of its own that does this; its id."""
    if child := os.fork():
        return child
    code = 1
    try:
        os.setsid()
        for number, path in ((1, stdout), (2, stderr)):
            os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
        become()
        code = 0
    except SystemExit as end:
        code = int(end.code or 0)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def wait_for(pid: int) -> int:
    """A process's exit code, minus a signal's number."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def is_running(pid: int) -> bool:
    """Whether a child has not ended; one that has stays to be waited for."""
    return os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None


def await_until(happened: Callable[[], bool], run: int) -> None:
    """Wait for something, or for a child's end."""
    while not happened() and is_running(run):
        time.sleep(0.01)
