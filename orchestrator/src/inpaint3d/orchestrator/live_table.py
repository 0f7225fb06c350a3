"""What a person sees on a terminal while a run goes on."""

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress_bar import ProgressBar
from rich.table import Table

from inpaint3d.orchestrator.progress import Eta
from inpaint3d.orchestrator.tables import printable


class LiveTable:
    """A table with a row for each stage: state, bar, time left."""

    def __init__(self, nodes: list[str]) -> None:
        self._rows: dict[str, dict[str, Any]] = {n: {"status": "", "text": ""} for n in nodes}
        self._eta = Eta()
        self._live = Live(self._make_table(), console=Console(), refresh_per_second=4)
        self._live.start()

    def node(self, node: str, status: str, reason: str = "", **values: Any) -> None:
        text = values.get("error") or reason
        self._rows[node] = {"status": status, "text": text}
        self._live.update(self._make_table())

    def progress(self, node: str, event: Mapping[str, Any]) -> None:
        done, total = float(event["done"]), float(event["total"])
        self._rows[node] |= {
            "bar": ProgressBar(total=total, completed=done, width=24),
            "eta": self._eta.seconds(node, done, total),
            "text": event.get("message", ""),
        }
        self._live.update(self._make_table())

    def close(self) -> None:
        self._live.stop()

    def _make_table(self) -> Table:
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
