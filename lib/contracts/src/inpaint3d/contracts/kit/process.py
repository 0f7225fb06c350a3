"""What a stage's process keeps to with whoever started it: events, threads, signals, last words."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Generator
from pathlib import Path
from typing import TextIO

from inpaint3d.contracts.errors import Inpaint3dError, InterruptedRun
from inpaint3d.contracts.kit.context import Context

LAST_WORDS = "INPAINT3D_LAST_WORDS"
"""A file to leave the error in that a stage ends with: of a pod, what its cluster shows beside the exit code."""
LONGEST_WORDS = 4096  # bytes that Kubernetes keeps
GRACE_S = 10.0


@contextlib.contextmanager
def open_events() -> Generator[TextIO]:
    """The event stream on the real standard output; descriptor 1 goes to standard error for everybody else."""
    descriptor = os.dup(1)
    os.dup2(2, 1)
    with os.fdopen(descriptor, "w") as events:
        yield events


def announce_threads(count: int) -> None:
    """Tell native libraries, which read it when they are first imported, how many threads they may have."""
    os.environ.update(thread_environment(count))
    # Threads that wait by spinning take cores from whoever else needs them, themselves included.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


def thread_environment(count: int) -> dict[str, str]:
    """What native libraries read of how many threads they may have."""
    return dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), str(count))


def leave_at_once(_number: int, _frame: object) -> None:
    """A handler of signals for while a stage is not yet at work."""
    sys.exit(InterruptedRun.exit_code)


@contextlib.contextmanager
def stop_on_signals(ctx: Context) -> Generator[None]:
    """Turn SIGTERM and SIGINT into InterruptedRun at the next progress call; leave by force after a grace."""

    def leave() -> None:
        os._exit(143)

    timer = threading.Timer(GRACE_S, leave)
    timer.daemon = True

    def stop(_signal: int, _frame: object) -> None:
        if not ctx.stopping:
            ctx.stopping = True
            timer.start()

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = {s: signal.signal(s, stop) for s in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield
    finally:
        timer.cancel()
        for number, handler in before.items():
            signal.signal(number, handler)


def leave_last_words(error: Inpaint3dError) -> None:
    """Leave an error's message where who runs the container looks for it; nothing where that cannot be written."""
    if place := os.environ.get(LAST_WORDS):
        with contextlib.suppress(OSError):
            Path(place).write_bytes(f"{error.kind}: {error}".encode()[:LONGEST_WORDS])
