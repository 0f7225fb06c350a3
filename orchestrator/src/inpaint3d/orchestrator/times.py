"""The part of the report that weighs accuracy against time: what stopping a fit earlier would have cost."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store
from inpaint3d.report.charts import Line, line_chart
from inpaint3d.report.page import render

FIGURES = ("psnr", "held_out_psnr", "held_out_loss", "loss")
SHARES = (0.25, 0.5, 0.75, 1.0)


@dataclass(frozen=True)
class Stop:
    """What a stage had reached at a share of its time; `change` is its figure minus that of the end."""

    share: float
    wall_s: float
    cpu_s: float
    value: float
    change: float


@dataclass(frozen=True)
class Curve:
    """A figure that grows or falls with the work of a stage."""

    title: str
    figure: str
    chart: str
    stops: Sequence[Stop]


def render_times(store: Store, record: RunRecord) -> str:
    """The section of a report on what accuracy costs: learning curves against seconds; "" where there are none."""
    return render("inpaint3d.orchestrator", "times.html.j2", curves=_find_curves(store, record))


def _find_curves(store: Store, record: RunRecord) -> list[Curve]:
    curves: list[Curve | None] = []
    for node in record.nodes:
        if node.key is not None and (found := store.lookup(node.key, verify=False)) is not None:
            series = found.timings.get("series", {})
            curves += [_find_curve(f"{node.node}: {name.replace('_', ' ')}", rows) for name, rows in series.items()]
    return [curve for curve in curves if curve is not None]


def _find_curve(title: str, rows: Sequence[dict[str, Any]]) -> Curve | None:
    """The first of `FIGURES` that a series has; None where it has none, or one that was measured once."""
    figure = next((f for f in FIGURES if any(f in r for r in rows)), None)
    points = [(float(r["wall_s"]), float(r["cpu_s"]), float(r[figure])) for r in rows if figure and figure in r]
    if figure is None or len(points) < 2:
        return None
    last_wall, _, last = points[-1]
    reached = [(share, min(points, key=lambda p: abs(p[0] - share * last_wall))) for share in SHARES]
    stops = [Stop(share, wall, cpu, value, value - last) for share, (wall, cpu, value) in reached]
    chart = line_chart([Line(figure, [(wall, value) for wall, _, value in points])], "wall s", figure)
    return Curve(title, figure, chart, stops)
