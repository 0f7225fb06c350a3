"""A stage as a process of this machine, and what the scheduler sees of a stage however it runs."""

import json
import os
import queue
import subprocess
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TextIO

from inpaint3d.contracts.kit.confine import select_environment
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.process import GRACE_S
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.runners.forks import ForkServers, Process

Event = tuple[str, Mapping[str, Any]]
"""(node, what the shim said); the last one of a node is `{"event": "exit", "code": …}`."""


class Runner(Protocol):
    """Says how a stage is started: the module that is run, its arguments, and their environment. The process prints
    the shim's events, honours SIGTERM, and exits with the shim's codes once the result is in the store.
    """

    def command(self, spec: StageSpec, store: Store, key: Digest, request: Path) -> list[str]: ...
    def environment(self) -> dict[str, str]: ...


class ProcessRunner:
    """Stages as processes in this machine's own environment."""

    def command(self, spec: StageSpec, store: Store, key: Digest, request: Path) -> list[str]:  # noqa: ARG002
        """The stage's own module; the shim works out the key itself."""
        return [spec.spec.module, "run", "--store", store.place, "--invocation", str(request)]

    def environment(self) -> dict[str, str]:
        """As little of this process's own as a stage needs."""
        return select_environment(os.environ)


@dataclass
class RunningStage:
    """A stage process, its events going into a queue shared by all."""

    node: str
    process: Process
    threads: int
    last_error: dict[str, Any] = field(default_factory=dict[str, Any])

    def stop(self) -> None:
        """Ask it to stop; its checkpoints are kept."""
        if self.process.poll() is None:
            self.process.terminate()

    def wait(self) -> None:
        """Until it has ended; what does not stop in time is killed."""
        try:
            self.process.wait(timeout=3 * GRACE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()


@dataclass
class Starter:
    """Starts the stages of one run; what they say arrives in `events`."""

    runner: Runner
    store: Store
    private: Path
    """The run's own folder, where what is asked of the stages is left for as long as the run lasts."""
    events: "queue.Queue[Event]"
    _servers: ForkServers = field(default_factory=ForkServers)

    def start(self, node: str, spec: StageSpec, key: Digest, invocation: Invocation, log: Path) -> RunningStage:
        """Start a stage; what it prints arrives in `log`."""
        request = self.private / f"{node}.invocation.json"
        request.write_text(invocation.model_dump_json())
        line = self.runner.command(spec, self.store, key, request)
        environment = {**self.runner.environment(), "PYTHONUNBUFFERED": "1"}
        with log.open("w") as errors:
            process, output = self._servers.start(line, environment, invocation.threads, errors)
        running = RunningStage(node, process, invocation.threads)
        # A thread for each: reading ends when its last process has closed its end, whatever the others do.
        threading.Thread(target=_listen, args=(running, os.fdopen(output), self.events), daemon=True).start()
        return running

    def close(self) -> None:
        """Let go of what starts stages; those that run end with it."""
        self._servers.close()


def _listen(running: RunningStage, stream: TextIO, events: "queue.Queue[Event]") -> None:
    with stream:
        for line in stream:
            try:
                events.put((running.node, json.loads(line)))
            except json.JSONDecodeError:
                events.put((running.node, {"event": "log", "message": line.rstrip()}))
    events.put((running.node, {"event": "exit", "code": running.process.wait()}))
