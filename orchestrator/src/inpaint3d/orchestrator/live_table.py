"""What a person sees on a terminal while a run goes on."""

import time
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn, TimeRemainingColumn
from rich.text import Text

from inpaint3d.orchestrator.tables import printable

COLOURS = {"done": "green", "cached": "cyan", "failed": "red", "running": "yellow", "waiting": "magenta"}
ETA_WINDOW_S = 60.0
"""The time left follows from the pace of so long: short enough to follow it, long enough not to jump."""


class LiveTable:
    """A line for each stage: state, how long it took or has been at it, how far it is, time left, and a note."""

    def __init__(self, nodes: list[str], console: Console | None = None) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            TextColumn("{task.fields[state]}"),
            _Duration(),
            _Bar(bar_width=24),
            _Left(compact=True),
            TextColumn("[dim]{task.fields[note]}"),
            console=console or Console(),
            refresh_per_second=4,
            speed_estimate_period=ETA_WINDOW_S,
        )
        self._tasks: dict[str, TaskID] = {n: self._add(n) for n in nodes}
        self._progress.start()

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None:
        """A stage's state and what there is to say of it; what it says while it runs is a note, not a state."""
        if node not in self._tasks:  # one that does not run, with why
            self._tasks[node] = self._add(node)
        task = self._tasks[node]
        fields: dict[str, Any] = {"state": f"[{COLOURS.get(status, 'dim')}]{status}[/]", "status": status}
        fields["note"] = escape(printable(str(values.get("error") or reason)))
        if status == "running" and self._find(task).fields["since"] is None:
            fields["since"] = time.monotonic()
        if values.get("wall_s") is not None and status == "done":
            fields["took"] = float(values["wall_s"])
        self._progress.update(task, **fields)

    def progress(self, node: str, event: Mapping[str, Any]) -> None:
        task, done, total = self._tasks[node], float(event["done"]), float(event["total"])
        known = self._find(task)
        if known.total != total or done < known.completed:  # another part of its work: the pace starts anew
            self._progress.reset(task, total=total, start=True)
        note = escape(printable(str(event.get("message", ""))))
        self._progress.update(task, completed=done, total=total, note=note)

    def close(self) -> None:
        self._progress.stop()

    def _find(self, task: TaskID) -> Task:
        return next(t for t in self._progress.tasks if t.id == task)

    def _add(self, node: str) -> TaskID:
        return self._progress.add_task(
            node, total=None, start=False, state="", status="", note="", since=None, took=None
        )


class _Duration(ProgressColumn):
    """How long a stage took, or has been running."""

    def render(self, task: Task) -> Text:
        since, took = task.fields["since"], task.fields["took"]
        if took is None and since is not None and task.fields["status"] == "running":
            took = time.monotonic() - since
        return Text("" if took is None else f"{int(took) // 60}:{int(took) % 60:02d}", justify="right")


class _Bar(BarColumn):
    """Of what runs and says how far it is; nothing else has one."""

    def render(self, task: Task) -> Any:
        return super().render(task) if task.fields["status"] == "running" and task.total is not None else Text("")


class _Left(TimeRemainingColumn):
    max_refresh = None  # what has ended has no time left at once

    def render(self, task: Task) -> Text:
        return super().render(task) if task.fields["status"] == "running" and task.total is not None else Text("")
