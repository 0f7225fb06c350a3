"""Stages forked off by servers (`contracts.kit.fork_server`), one for each number of threads."""

import contextlib
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import IO, Protocol, Self

from inpaint3d.contracts.kit.confine import select_environment
from inpaint3d.contracts.kit.fork_server import LARGEST, Request
from inpaint3d.contracts.kit.process import thread_environment

PRELOADED = (
    "inpaint3d.contracts.kit.shim",
    "numpy",
    "inpaint3d.scene.capture_io",
    "inpaint3d.scene.image_io",
    "safetensors.numpy",
)
"""What most stages import. Named, not imported: the orchestrator needs none of it."""
SERVER_GONE = -signal.SIGKILL


class Process(Protocol):
    """As much of `subprocess.Popen` as the scheduler uses."""

    @property
    def pid(self) -> int: ...
    def poll(self) -> int | None: ...
    def terminate(self) -> None: ...
    def kill(self) -> None: ...
    def wait(self, timeout: float | None = None) -> int: ...


class ForkedProcess:
    """A process that a server has forked."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.ended: Future[int] = Future()

    def poll(self) -> int | None:
        return self.ended.result() if self.ended.done() else None

    def terminate(self) -> None:
        self._send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self._send_signal(signal.SIGKILL)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code, minus a signal's number; subprocess.TimeoutExpired where it has not ended by then."""
        try:
            return self.ended.result(timeout)
        except FutureTimeoutError as error:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0) from error

    def _send_signal(self, number: int) -> None:
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, number)


class ForkServer:
    """The other end of a server's socket."""

    def __init__(self, connection: socket.socket, process: Process) -> None:
        self._connection, self._process = connection, process
        self._forked: queue.SimpleQueue[ForkedProcess | None] = queue.SimpleQueue()
        self._running: dict[int, ForkedProcess] = {}
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    @classmethod
    def start(cls) -> Self:
        """Start a server as a process of its own."""
        ours, theirs = _open_socket_pair()
        line = [sys.executable, "-m", "inpaint3d.contracts.kit.fork_server"]
        with theirs:
            process = subprocess.Popen(line, stdin=theirs.fileno(), stdout=subprocess.DEVNULL, env=_make_environment())
        return cls(ours, process)

    def fork_server(self, threads: int) -> "ForkServer | None":
        """Another server, which has imported what most stages do, for this many threads; None: this one is gone."""
        ours, theirs = _open_socket_pair()
        environment = {**_make_environment(), **thread_environment(threads)}
        with theirs:
            request = Request(module="", arguments=(), environment=environment, preload=PRELOADED)
            forked = self._send(request, [theirs.fileno()])
        return None if forked is None else ForkServer(ours, forked)

    def fork(self, line: list[str], environment: Mapping[str, str], out: int, err: IO[str]) -> ForkedProcess | None:
        """Fork `python -m LINE`, which writes to these descriptors; None where the server is gone."""
        return self._send(Request(line[0], tuple(line[1:]), dict(environment)), [out, err.fileno()])

    def close(self) -> None:
        """End the server; of what it has forked, what still runs is told to end."""
        with contextlib.suppress(OSError):  # it is gone
            self._connection.shutdown(socket.SHUT_RDWR)
        self._process.wait()
        self._connection.close()

    def _send(self, request: Request, descriptors: list[int]) -> ForkedProcess | None:
        try:
            socket.send_fds(self._connection, [request.encode()], descriptors)
        except OSError:
            return None
        return self._forked.get()

    def _listen(self) -> None:
        while data := self._receive():
            answer = json.loads(data)
            if (code := answer.get("code")) is None:
                process = self._running[answer["pid"]] = ForkedProcess(answer["pid"])
                self._forked.put(process)
            else:
                self._running.pop(answer["pid"]).ended.set_result(code)
        self._forked.put(None)
        for process in self._running.values():  # it took them along
            process.ended.set_result(SERVER_GONE)

    def _receive(self) -> bytes:
        try:
            return self._connection.recv(LARGEST)
        except OSError:
            return b""


class ForkServers:
    """The servers of one run, started when they are first needed."""

    def __init__(self) -> None:
        self._first: ForkServer | None = None
        self._by_threads: dict[int, ForkServer] = {}

    def start(self, line: list[str], environment: Mapping[str, str], threads: int, err: IO[str]) -> tuple[Process, int]:
        """`python -m LINE` as a process; it, and the descriptor that its standard output is read from."""
        read, write = os.pipe()
        try:
            for _ in range(2):  # a server may have been killed: then another one
                server = self._find_server(threads)
                if server is not None and (forked := server.fork(line, environment, write, err)) is not None:
                    return forked, read
                self.close()
            command = [sys.executable, "-m", *line]
            return subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=write, stderr=err, env=dict(environment)
            ), read
        finally:
            os.close(write)

    def close(self) -> None:
        """End the servers."""
        for server in (*self._by_threads.values(), *([self._first] if self._first else [])):
            server.close()
        self._first, self._by_threads = None, {}

    def _find_server(self, threads: int) -> ForkServer | None:
        if sys.platform != "linux":  # what forks safely after which import is known of Linux alone
            return None
        if threads not in self._by_threads:
            self._first = self._first or ForkServer.start()
            if (server := self._first.fork_server(threads)) is None:
                return None
            self._by_threads[threads] = server
        return self._by_threads[threads]


def _open_socket_pair() -> tuple[socket.socket, socket.socket]:
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def _make_environment() -> dict[str, str]:
    return {**select_environment(os.environ), "PYTHONUNBUFFERED": "1"}
