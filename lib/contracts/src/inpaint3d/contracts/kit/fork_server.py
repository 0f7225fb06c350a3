"""Starts stages by forking: what every stage imports is imported once, by a process that does nothing else.

    python -m inpaint3d.contracts.kit.fork_server    with a socket for standard input

A request is one message (SOCK_SEQPACKET) of JSON, `Request`, with the descriptors that the new process gets: standard
output and standard error, or, for another server, its socket. Answers are `{"pid": …}` once it has been forked, in
the order of the requests, and `{"pid": …, "code": …}` when it has ended. The server ends when the other end is closed;
Linux then tells what it had forked to end (`die_with_parent`).

A forked process is as one that was started anew: own environment, signals as they were, and where one of our files has
changed since the server read it, it starts anew indeed.
"""

import atexit
import contextlib
import gc
import importlib
import json
import os
import runpy
import select
import signal
import socket
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NoReturn

STARTED_NS = time.time_ns()
CLOCK_TICK_NS = 20_000_000
"""Times of files may be this much older than the clock."""
OURS = "inpaint3d."
LARGEST = 1 << 18
DEAF_TO = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""A terminal tells the whole group; the server lives as long as who asks it, and its stages are told one by one."""


@dataclass(frozen=True)
class Request:
    """What to become: `python -m MODULE ARGUMENTS` in an environment, or, without a module, another server."""

    module: str
    arguments: tuple[str, ...]
    environment: dict[str, str]
    preload: tuple[str, ...] = ()
    """What another server imports, those that are installed."""

    def encode(self) -> bytes:
        return json.dumps(asdict(self)).encode()


def main() -> NoReturn:
    """Serve; a forked process leaves the loop and becomes what it was forked for."""
    for number in DEAF_TO:
        signal.signal(number, signal.SIG_IGN)
    connection = socket.socket(fileno=os.dup(0))
    while (forked := serve(connection)) is not None:
        request, descriptors = forked
        os.environ.clear()
        os.environ.update(request.environment)
        if request.module:
            become(request, descriptors)
        connection = socket.socket(fileno=descriptors[0])
        _import_all(request.preload)
    _leave(0)


def serve(connection: socket.socket) -> tuple[Request, list[int]] | None:
    """Fork what is asked for until the other end is closed (None). In a forked process: what it is to become."""
    heard, wake = os.pipe()
    os.set_blocking(heard, False)
    os.set_blocking(wake, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda _number, _frame: None)
    while True:
        for ready in select.select([connection, heard], [], [])[0]:
            if ready == heard:
                with contextlib.suppress(BlockingIOError):
                    os.read(heard, LARGEST)
                _tell(connection, *({"pid": pid, "code": code} for pid, code in _reap()))
                continue
            data, descriptors, _, _ = socket.recv_fds(connection, LARGEST, 2)
            if not data:
                return None
            if (pid := os.fork()) == 0:
                signal.set_wakeup_fd(-1)
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                connection.close()
                os.close(heard)
                os.close(wake)
                given = json.loads(data)
                return Request(given["module"], tuple(given["arguments"]), given["environment"], given["preload"]), (
                    descriptors
                )
            _tell(connection, {"pid": pid})
            for descriptor in descriptors:
                os.close(descriptor)


def become(request: Request, descriptors: list[int]) -> NoReturn:
    """Be `python -m MODULE ARGUMENTS`, with these for standard output and standard error. Ends the process."""
    for target, source in enumerate((os.open(os.devnull, os.O_RDONLY), *descriptors)):
        os.dup2(source, target)
        os.close(source)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)
    if has_changed():
        os.execve(  # noqa: S606 - this interpreter
            sys.executable, [sys.executable, "-m", request.module, *request.arguments], request.environment
        )
    sys.argv = [request.module, *request.arguments]
    try:
        runpy.run_module(request.module, run_name="__main__", alter_sys=True)
        code: object = 0
    except SystemExit as error:
        code = error.code
    except BaseException:
        traceback.print_exc()
        code = 1
    _leave(code)


def _leave(code: object) -> NoReturn:
    """End as `multiprocessing` ends what it has forked: to take all modules apart takes as long as a small stage."""
    if code is not None and not isinstance(code, int):
        sys.stderr.write(f"{code}\n")
        code = 1
    for thread in threading.enumerate():
        if thread is not threading.main_thread() and not thread.daemon:
            thread.join()
    atexit._run_exitfuncs()  # pyright: ignore[reportPrivateUsage] - there is no public name for it
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code or 0)


def has_changed() -> bool:
    """Whether a file of ours has changed since the server began, which may have read it before."""
    since = STARTED_NS - CLOCK_TICK_NS
    files = {m.__file__ for n, m in sys.modules.items() if n.startswith(OURS) and m.__file__}
    try:
        return any(Path(file).stat().st_ctime_ns > since for file in files)
    except OSError:  # removed
        return True


def _import_all(modules: tuple[str, ...]) -> None:
    for module in modules:
        with contextlib.suppress(ModuleNotFoundError):
            importlib.import_module(module)
    prepare = getattr(sys.modules.get("inpaint3d.contracts.kit.shim"), "prepare", None)
    if prepare is not None:
        prepare()
    gc.freeze()  # else the first collection of each forked process would touch, and so copy, all of it


def _reap() -> Iterator[tuple[int, int]]:
    """(pid, exit code; minus a signal's number) of what has ended."""
    with contextlib.suppress(ChildProcessError):
        while (ended := os.waitpid(-1, os.WNOHANG))[0]:
            yield ended[0], os.waitstatus_to_exitcode(ended[1])


def _tell(connection: socket.socket, *answers: dict[str, int]) -> None:
    for answer in answers:
        with contextlib.suppress(BrokenPipeError):  # the other end is closed, which the next read says
            connection.send(json.dumps(answer).encode())


if __name__ == "__main__":
    main()
