"""What the command line prints of runs."""

import json
import sys
from collections.abc import Iterable, Sequence
from typing import Any

from inpaint3d.contracts.models.report import EffectFigures, NodeRun


def printable(text: str) -> str:
    """Text for a terminal: control characters, which names and messages may hold, as escapes that can be read."""
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[str]], *, wrapped: Sequence[str] = (), width: int | None = None
) -> None:
    """Print plain text in columns. `wrapped`: the columns whose text may take several lines; none: all."""
    from rich.console import Console  # a tenth of a second, which a command that prints no table does without
    from rich.markup import escape
    from rich.table import Table

    table = Table(box=None)
    for column in columns:
        table.add_column(column, no_wrap=bool(wrapped) and column not in wrapped)
    for row in rows:
        table.add_row(*(escape(printable(cell)) for cell in row))
    Console(width=width).print(table)


def show_nodes(nodes: list[NodeRun], *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps([n.model_dump(mode="json") for n in nodes], indent=2) + "\n")
        return
    columns = ("stage", "state", "wall s", "CPU s", "peak MiB", "why")
    print_table(columns, map(_describe_node, nodes), wrapped=("why",))


def _describe_node(n: NodeRun) -> list[str]:
    memory = "" if n.peak_memory_bytes is None else f"{n.peak_memory_bytes / 2**20:.0f}"
    figures = ["" if v is None else f"{v:.1f}" for v in (n.wall_s, n.cpu_s)]
    changes = "".join(f"\n  {c.component}: {json.dumps(c.old)} -> {json.dumps(c.new)}" for c in n.changes)
    return [n.node, n.status, *figures, memory, n.reason + changes]


def show_effects(effects: Sequence[EffectFigures], *, as_json: bool = False) -> None:
    """Decisions with what they rest on: effect size, held-out gain, measured cost."""
    if as_json:
        sys.stdout.write(json.dumps([e.model_dump(mode="json") for e in effects], indent=2) + "\n")
        return
    columns = ("effect", "state", "size (95 %)", "gain (95 %)", "step", "why")
    print_table(columns, map(_describe_effect, effects), wrapped=("why",), width=160)


def _describe_effect(found: EffectFigures) -> list[str]:
    effect = found.effect
    ranges = ["" if i is None else f"{i.value:.3g} ({i.low:.3g} to {i.high:.3g})" for i in (effect.size, effect.gain)]
    cost = "" if found.step_ratio is None else f"x {found.step_ratio:.2f}"
    return [effect.name, effect.state, *ranges, cost, effect.reason]


def show_scores(table: dict[str, Any]) -> None:
    """The rows of `tabulate`, and under them how each scene was scored."""
    rows: list[list[str]] = []
    for row in (*table["scenes"], table["mean"], *table["published"]):
        values = ["" if (v := row["figures"].get(name)) is None else f"{v:.4g}" for name in table["metrics"]]
        views = "" if row.get("views") is None else str(row["views"])
        rows.append([row["name"], row.get("method") or "", views, *values])
    print_table(("scene", "method", "views", *table["metrics"]), rows, width=140)
    for row in table["published"]:
        sys.stdout.write(f"\n{printable(row['name'])}: {row['protocol']}; {row['source']}\n")
    for row in table["scenes"]:
        sys.stdout.write(f"\n{printable(row['name'])}: {row['protocol'] or 'failed; see above'}\n")
