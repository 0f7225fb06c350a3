"""What a person or a program sees of a run as it goes on: a live table on a terminal, JSON lines elsewhere."""

import contextlib
import json
import math
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

JSON_INTERVAL_S = 5.0
RECORD_INTERVAL_S = 1.0
PROGRESS = "progress.json"
"""Of a run's folder, while the run goes on."""


class Display(Protocol):
    """Told of everything that happens; `status` is that of a node (report.Status), or running."""

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None: ...
    def progress(self, node: str, event: Mapping[str, Any]) -> None: ...
    def close(self) -> None: ...


class Eta:
    """Time left, from the pace since a node began the part of its work that it is at."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[float, float, float]] = {}

    def seconds(self, node: str, done: float, total: float) -> float | None:
        """Of this part alone; a part is known by how much there is to do. None while the pace is not known."""
        now = time.monotonic()
        at, before, of = self._first.setdefault(node, (now, done, total))
        if of != total or done < before:
            self._first[node] = at, before, _ = now, done, total
        if done <= before or now - at < 1.0:
            return None
        return max(0.0, (total - done) * (now - at) / (done - before))


class JsonLines:
    """One JSON object a line on standard output; progress at most every few seconds a node."""

    def __init__(self) -> None:
        self._eta = Eta()
        self._last: dict[str, float] = {}

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None:
        self._print({"event": "stage", "stage": node, "status": status, "reason": reason, **values})

    def progress(self, node: str, event: Mapping[str, Any]) -> None:
        now = time.monotonic()
        eta = self._eta.seconds(node, event["done"], event["total"])
        if now - self._last.get(node, 0.0) >= JSON_INTERVAL_S or event["done"] >= event["total"]:
            self._last[node] = now
            self._print({**event, "stage": node, "eta_s": None if eta is None else round(eta, 1)})

    def close(self) -> None:
        sys.stdout.flush()

    def _print(self, value: Mapping[str, Any]) -> None:
        sys.stdout.write(json.dumps({"time": round(time.time(), 3), **value}) + "\n")
        sys.stdout.flush()


class Recorded:
    """A display that also leaves in a file where each stage is, for who looks from outside; once a second at most."""

    def __init__(self, display: Display, file: Path) -> None:
        self._display, self._file = display, file
        self._state: dict[str, dict[str, Any]] = {}
        self._written = -math.inf

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None:
        self._display.node(node, status, reason, **values)
        if status == "running":
            self._state.setdefault(node, {})
        else:
            self._state.pop(node, None)
        self._write()

    def progress(self, node: str, event: Mapping[str, Any]) -> None:
        self._display.progress(node, event)
        self._state[node] = {name: event.get(name) for name in ("done", "total", "message")}
        self._write()

    def close(self) -> None:
        self._display.close()
        self._file.unlink(missing_ok=True)

    def _write(self) -> None:
        now = time.monotonic()
        if now - self._written >= RECORD_INTERVAL_S:
            self._written = now
            staged = self._file.with_name(f"{self._file.name}.new")
            with contextlib.suppress(OSError):  # it is looked at, and nothing depends on it
                staged.write_text(json.dumps(self._state))
                staged.replace(self._file)


def choose_display(log_format: str, nodes: list[str]) -> Display:
    """`auto`: a table on a terminal, JSON lines elsewhere; `json` and `table` say which."""
    as_table = log_format == "table" or (log_format == "auto" and sys.stdout.isatty())
    if not as_table:
        return JsonLines()
    from inpaint3d.orchestrator.live_table import LiveTable  # what draws it takes a tenth of a second to import

    return LiveTable(nodes)
