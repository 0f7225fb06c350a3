"""A stage as a process of this machine, and what the scheduler sees of a stage however it runs."""

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.shim import GRACE_S
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.contracts.store import Store

Event = tuple[str, Mapping[str, Any]]
"""(node, what the shim said); the last one of a node is `{"event": "exit", "code": …}`."""


class Runner(Protocol):
    """Says how a stage is started. The process it names prints the shim's events, honours SIGTERM, and exits with
    the shim's codes once the result is in the store.
    """

    def command(self, spec: StageSpec, store: Store, key: Digest, request: Path) -> list[str]: ...


class ProcessRunner:
    """Stages as processes in this machine's own environment."""

    def command(self, spec: StageSpec, store: Store, key: Digest, request: Path) -> list[str]:  # noqa: ARG002
        """The shim works out the key itself."""
        return [sys.executable, "-m", spec.spec.module, "run", "--store", store.place, "--invocation", str(request)]


@dataclass
class RunningStage:
    """A stage process, its events going into a queue shared by all."""

    node: str
    process: subprocess.Popen[str]
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


def start(
    node: str,
    runner: Runner,
    spec: StageSpec,
    store: Store,
    key: Digest,
    invocation: Invocation,
    log: Path,
    private: Path,
    events: "queue.Queue[Event]",
) -> RunningStage:
    """Start a stage; what it says arrives in `events`, what it prints in `log`.

    private: the run's own folder, where what is asked of the stage is left for as long as the run lasts.
    """
    request = private / f"{node}.invocation.json"
    request.write_text(invocation.model_dump_json())
    line = runner.command(spec, store, key, request)
    with log.open("w") as errors:
        process = subprocess.Popen(
            line, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, text=True, env=_environment()
        )
    running = RunningStage(node, process, invocation.threads)
    threading.Thread(target=_listen, args=(running, events), daemon=True).start()
    return running


def _environment() -> dict[str, str]:
    # A terminal's control-C goes to the whole group; the orchestrator passes on SIGTERM itself.
    return {**os.environ, "PYTHONUNBUFFERED": "1"}


def _listen(running: RunningStage, events: "queue.Queue[Event]") -> None:
    stream = running.process.stdout or ()  # it was asked for as a pipe
    for line in stream:
        try:
            events.put((running.node, json.loads(line)))
        except json.JSONDecodeError:
            events.put((running.node, {"event": "log", "message": line.rstrip()}))
    events.put((running.node, {"event": "exit", "code": running.process.wait()}))
