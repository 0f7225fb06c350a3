"""What a person or a program sees while a run goes on: a live table on a terminal, JSON lines elsewhere."""

import json
import sys
import time
from collections.abc import Mapping
from typing import Any, Protocol

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table

from inpaint3d.orchestrator.tables import printable

JSON_INTERVAL_S = 5.0


class Display(Protocol):
    """Told of everything that happens; `status` is that of a node (report.Status), or running."""

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None: ...
    def progress(self, node: str, event: Mapping[str, Any]) -> None: ...
    def close(self) -> None: ...


class Eta:
    """Time left, from the pace since a node was first heard of."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[float, float]] = {}

    def seconds(self, node: str, done: float, total: float) -> float | None:
        now = time.monotonic()
        at, before = self._first.setdefault(node, (now, done))
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


class LiveTable:
    """A table with a row for each stage: state, bar, time left."""

    def __init__(self, nodes: list[str]) -> None:
        self._rows: dict[str, dict[str, Any]] = {n: {"status": "", "text": ""} for n in nodes}
        self._eta = Eta()
        self._live = Live(self._table(), console=Console(), refresh_per_second=4)
        self._live.start()

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None:
        text = values.get("error") or reason
        self._rows[node] = {"status": status, "text": text}
        self._live.update(self._table())

    def progress(self, node: str, event: Mapping[str, Any]) -> None:
        done, total = float(event["done"]), float(event["total"])
        self._rows[node] |= {
            "bar": ProgressBar(total=total, completed=done, width=24),
            "eta": self._eta.seconds(node, done, total),
            "text": event.get("message", ""),
        }
        self._live.update(self._table())

    def close(self) -> None:
        self._live.stop()

    def _table(self) -> Table:
        colours = {"done": "green", "cached": "cyan", "failed": "red", "running": "yellow", "waiting": "magenta"}
        table = Table(box=None, pad_edge=False)
        for title in ("stage", "state", "", "left", ""):
            table.add_column(title, no_wrap=title != "")
        for name, row in self._rows.items():
            status = row["status"]
            eta = row.get("eta") if status == "running" else None
            left = "" if eta is None else f"{int(eta) // 60}:{int(eta) % 60:02d}"
            bar = row.get("bar", "") if status == "running" else ""
            table.add_row(
                name, f"[{colours.get(status, 'dim')}]{status}[/]", bar, left, escape(printable(str(row["text"])))
            )
        return table


def choose_display(log_format: str, nodes: list[str]) -> Display:
    """`auto`: a table on a terminal, JSON lines elsewhere; `json` and `table` say which."""
    as_table = log_format == "table" or (log_format == "auto" and sys.stdout.isatty())
    return LiveTable(nodes) if as_table else JsonLines()
