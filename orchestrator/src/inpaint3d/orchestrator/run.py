"""The scheduler: starts each stage when its inputs are known and the machine has room, and records what happened."""

import contextlib
import datetime
import os
import queue
import signal
import tempfile
import time
from collections.abc import Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from inpaint3d.contracts.errors import (
    EXIT_CODES,
    ConfigurationError,
    DoubtfulError,
    Inpaint3dError,
    InterruptedRun,
    RetryableError,
    WaitingError,
)
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.models.report import NodeRun, RunRecord, Status
from inpaint3d.contracts.models.stage import count_cpus
from inpaint3d.contracts.store import Record, this_process
from inpaint3d.orchestrator.history import this_machine
from inpaint3d.orchestrator.intake import MASK_REQUEST
from inpaint3d.orchestrator.plan import NOT_SELECTED, Planner, Selection, Task, describe_node
from inpaint3d.orchestrator.progress import Display
from inpaint3d.orchestrator.runners.process import Event, ProcessRunner, Runner, RunningStage, Starter

RunStatus = Literal["running", "done", "failed", "waiting", "stopped"]
POLL_S = 0.5
KILLED = 128 + signal.SIGKILL


@dataclass
class Scheduler:
    """One run of a pipeline over one scene."""

    planner: Planner
    selection: Selection
    display: Display
    folder: Path
    runner: Runner = field(default_factory=ProcessRunner)
    cores: int = field(default_factory=lambda: this_machine().cores)
    accept_doubtful: bool = False
    command: tuple[str, ...] = ()
    """The command line that asks for the run."""
    _running: dict[str, RunningStage] = field(default_factory=dict[str, RunningStage])
    _tasks: dict[str, Task] = field(default_factory=dict[str, Task])
    _results: dict[str, NodeRun] = field(default_factory=dict[str, NodeRun])
    _stopped: bool = False

    def __post_init__(self) -> None:
        self._events: queue.Queue[Event] = queue.Queue()
        self._chosen = set(self.selection.nodes(self.planner.pipeline))
        self._began = time.monotonic()
        self.planner.history.close_killed(self.planner.name)
        self.record = RunRecord(
            id=self.planner.history.new_id(self.planner.name),
            name=self.planner.name,
            pipeline=str(self.planner.pipeline.path),
            command=self.command,
            preset=self.planner.configured.preset,
            externals=self.planner.externals,
            status="running",
            started=datetime.datetime.now(datetime.UTC).isoformat(),
            process=str(this_process()),
            machine=this_machine(),
        )

    def run(self) -> RunRecord:
        """Run what is selected; returns the record. Stops early where a stage fails, waits, or the run is told to.

        However it ends, also by an exception, its stages have ended and its record says how.
        """
        (self.folder / "logs").mkdir(parents=True, exist_ok=True)
        try:
            with self._handle_signals(), self._open_starter():
                self._go_along()
        except BrokenPipeError as error:
            self._abort("stopped", gone := "nobody reads standard output any more")
            raise InterruptedRun(gone) from error
        except BaseException as error:
            self._abort("failed", str(error) or type(error).__name__)
            raise
        return self._finish()

    def _go_along(self) -> None:
        for row in self.planner.configured.left_out_rows:
            self.display.node(row.node, row.status, row.reason)
        while True:
            progressed = self._settle()
            if not self._running and not progressed:
                break
            self._hear()

    def _abort(self, status: RunStatus, message: str) -> None:
        """End the record of a run that an exception ends, whose stages have ended."""
        with contextlib.suppress(OSError):  # what failed may be the display
            self.display.close()
        for node in self._running:
            self._results[node] = describe_node(self._tasks[node], "stopped").model_copy(update={"error": message})
        self._running.clear()
        self._add_missing()
        self.record = self.record.model_copy(update={"error": message})
        with contextlib.suppress(
            OSError, Inpaint3dError
        ):  # what failed may be the store: the next run closes the record
            self._save(status, finished=True)

    def _settle(self) -> bool:
        """Look at every node whose inputs are known: take its stored result, or start it if there is room."""
        progressed = False
        for node in self.planner.pipeline.order:
            if node in self._results or node in self._running or not self.planner.known(node):
                continue
            if node not in self._tasks:
                force = self.selection.force and node in self._chosen
                self._tasks[node] = self.planner.task(node, force=force)
            task = self._tasks[node]
            if task.record is not None:
                self._accept(task, "cached", task.record)
                progressed = True
            elif node not in self._chosen:
                self._close(task, "skipped", reason=NOT_SELECTED)
            elif self._may_start() and (threads := self._count_free_threads(node)) > 0:
                self._start(task, threads)
                progressed = True
        return progressed

    def _may_start(self) -> bool:
        return not self._stopped and all(r.status not in ("failed", "waiting") for r in self._results.values())

    def _count_free_threads(self, node: str) -> int:
        """Threads for a node now: its request if free, up to its limit where nobody else is waiting; 0: no room."""
        resources = self.planner.pipeline.stages[node].spec.resources
        wanted = min(self.cores, max(1, int(count_cpus(resources.requests.get("cpu", "1")))))
        most = min(self.cores, int(count_cpus(resources.limits.get("cpu", resources.requests.get("cpu", "1")))))
        free = self.cores - sum(r.threads for r in self._running.values())
        if free < wanted and self._running:
            return 0
        rivals = [
            n
            for n in self.planner.pipeline.order
            if n != node and n in self._chosen and n not in self._results and n not in self._running
            and self.planner.known(n) and (n not in self._tasks or self._tasks[n].record is None)
        ]  # fmt: skip
        return max(wanted, 1 if rivals else min(most, free))

    def _start(self, task: Task, threads: int) -> None:
        spec = self.planner.pipeline.stages[task.node]
        invocation = Invocation(
            parameters=task.components["parameters"],
            inputs=task.inputs,
            seed=task.components["seed"],
            device=task.components["device"],
            stub=self.planner.stub,
            threads=threads,
            die_with_parent=True,
            accept_doubtful=True,  # whether to go on is decided by the record, which may be an earlier run's
        )
        log = self.folder / "logs" / f"{task.node}.log"
        self._running[task.node] = self._stages.start(task.node, spec, task.key, invocation, log)
        self.display.node(task.node, "running", task.reason, threads=threads)
        self._save("running")

    def _hear(self) -> None:
        try:
            node, event = self._events.get(timeout=POLL_S if self._running else 0)
        except queue.Empty:
            return
        running = self._running.get(node)
        if running is None:
            return
        if event["event"] == "progress":
            self.display.progress(node, event)
        elif event["event"] == "error":
            running.last_error = dict(event)
        elif event["event"] == "log":
            self.display.node(node, "running", str(event.get("message", "")))
        elif event["event"] == "exit":
            del self._running[node]
            self._handle_end(self._tasks[node], running, int(event["code"]))

    def _handle_end(self, task: Task, running: RunningStage, code: int) -> None:
        if code == 0 and (record := self.planner.store.lookup(task.key, verify=False)) is not None:
            self._accept(task, "done", record)
            return
        if code == 0:
            message = (
                "it ended well, but there is no result under its key: its source was edited after the plan was made, "
                "or somebody removed the result; run again"
            )
            self._close(task, "failed", error=message, exit_code=RetryableError.exit_code)
            return
        # A negative code is a signal's number: 128 + n is what a shell shows.
        code = code if code > 0 else 128 - code
        log = self.folder / "logs" / f"{task.node}.log"
        message = running.last_error.get("message") or f"{EXIT_CODES.get(code, 'died')} (exit {code})"
        if code == KILLED:
            limit = self.planner.pipeline.stages[task.node].spec.resources.limits.get("memory", "none")
            message = f"it was killed (exit {code}), as a rule for its memory; its limit in a container is {limit}"
        if code not in EXIT_CODES or code == Inpaint3dError.exit_code:
            message = f"{message}; see {log}"
        status: Status = "failed"
        if code == WaitingError.exit_code:
            status = "waiting"
        elif code == InterruptedRun.exit_code or self._stopped:
            status = "stopped"
        self._close(task, status, error=message, exit_code=code)

    def _accept(self, task: Task, status: Status, record: Record) -> None:
        run = describe_node(task, status, record=record)
        if run.doubts and not self.accept_doubtful:
            doubt = DoubtfulError(run.doubts)
            run = run.model_copy(update={"status": "failed", "error": str(doubt), "exit_code": doubt.exit_code})
        else:
            self.planner.outputs[task.node] = record.outputs
        self._results[task.node] = run
        self.display.node(task.node, run.status, run.error or task.reason, wall_s=run.wall_s, cpu_s=run.cpu_s)
        if (problem := self.planner.request_problem(task.node)) is not None:
            self._refuse_request(problem)
        if status == "done":  # of what is cached the next save tells, that of the end at the latest
            self._save("running")

    def _refuse_request(self, problem: str) -> None:
        """End the run before the stages that read the mask request have their turn, as they would end it."""
        pipeline = self.planner.pipeline
        for node in self._chosen:
            if any(f"external.{MASK_REQUEST}" in refs for refs in pipeline.references(node).values()):
                self._results[node] = NodeRun(
                    node=node, status="failed", reason="its mask request is wrong", after=self.planner.upstream(node),
                    error=problem, exit_code=ConfigurationError.exit_code,
                )  # fmt: skip
                self.display.node(node, "failed", error=problem)

    def _close(self, task: Task, status: Status, reason: str | None = None, **values: Any) -> None:
        run = describe_node(task, status, reason).model_copy(update=values)
        self._results[task.node] = run
        self.display.node(task.node, status, run.reason, **{k: v for k, v in values.items() if v is not None})
        self._save("running")

    def _finish(self) -> RunRecord:
        statuses = {r.status for r in self._results.values()}
        status: RunStatus = "done"
        for word in ("stopped", "waiting", "failed"):
            if word in statuses:
                status = word
        if self._stopped:
            status = "stopped"
        self._add_missing()
        if status == "done" and any(self._results[n].status in ("pending", "skipped") for n in self._chosen):
            status = "failed"
        self._save(status, finished=True)
        self.display.close()
        return self.record

    def _add_missing(self) -> None:
        """Nodes that never had their turn."""
        missing = [n for n in self.planner.pipeline.order if n not in self._results]
        for node in missing:
            waits_for = sorted(self.planner.pipeline.upstream(node) - self.planner.outputs.keys())
            what = "pending" if node in self._chosen else "skipped"
            reason = f"after {', '.join(waits_for)}"
            self._results[node] = NodeRun(node=node, status=what, reason=reason, after=self.planner.upstream(node))

    def _save(self, status: RunStatus, *, finished: bool = False) -> None:
        ordered = [self._results[n] for n in self.planner.pipeline.order if n in self._results]
        nodes = (*ordered, *self.planner.configured.left_out_rows)
        update: dict[str, Any] = {"status": status, "nodes": nodes}
        if finished:
            update["finished"] = datetime.datetime.now(datetime.UTC).isoformat()
            update["wall_s"] = round(time.monotonic() - self._began, 3)
        self.record = self.record.model_copy(update=update)
        self.planner.history.save(self.record)

    @contextlib.contextmanager
    def _open_starter(self) -> Generator[None]:
        with tempfile.TemporaryDirectory(prefix="inpaint3d-") as private:
            self._stages = Starter(self.runner, self.planner.store, Path(private), self._events)
            try:
                yield
            finally:
                self._end_stages()
                self._stages.close()

    def _end_stages(self) -> None:
        """Of a run that an exception ends; of another none is left."""
        for running in self._running.values():
            running.stop()
        for running in self._running.values():
            running.wait()

    @contextlib.contextmanager
    def _handle_signals(self) -> Generator[None]:
        """SIGINT, SIGTERM and SIGHUP stop the stages, which keep their checkpoints; a second one leaves at once."""

        def stop(number: int, _frame: object) -> None:
            if self._stopped:
                os._exit(128 + number)
            self._stopped = True
            for running in self._running.values():
                running.stop()

        before = {s: signal.signal(s, stop) for s in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
