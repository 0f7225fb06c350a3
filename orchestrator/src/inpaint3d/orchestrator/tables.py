"""What the command line prints of runs."""

import json
import sys
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table

from inpaint3d.contracts.models.report import NodeRun


def printable(text: str) -> str:
    """Text for a terminal: control characters, which names and messages may hold, as escapes that can be read."""
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


def show_nodes(nodes: list[NodeRun], *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps([n.model_dump(mode="json") for n in nodes], indent=2) + "\n")
        return
    fixed = [Column(title, no_wrap=True) for title in ("stage", "state", "wall s", "CPU s", "peak MiB")]
    table = Table(*fixed, "why", box=None)
    for n in nodes:
        memory = "" if n.peak_memory_bytes is None else f"{n.peak_memory_bytes / 2**20:.0f}"
        figures = ["" if v is None else f"{v:.1f}" for v in (n.wall_s, n.cpu_s)]
        changes = "".join(f"\n  {c.component}: {json.dumps(c.old)} -> {json.dumps(c.new)}" for c in n.changes)
        table.add_row(n.node, n.status, *figures, memory, escape(printable(n.reason + changes)))
    Console().print(table)


def show_scores(table: dict[str, Any]) -> None:
    """The rows of `tabulate`, and under them how each scene was scored."""
    shown = Table("scene", "method", "views", *table["metrics"], box=None)
    for row in (*table["scenes"], table["mean"], *table["published"]):
        values = ["" if (v := row["figures"].get(name)) is None else f"{v:.4g}" for name in table["metrics"]]
        views = "" if row.get("views") is None else str(row["views"])
        shown.add_row(escape(printable(row["name"])), row.get("method") or "", views, *values)
    Console(width=140).print(shown)
    for row in table["scenes"]:
        sys.stdout.write(f"\n{printable(row['name'])}: {row['protocol'] or 'failed; see above'}\n")
