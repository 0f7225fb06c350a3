"""The HTML report: one file that needs nothing beside it."""

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from inpaint3d.contracts.models.artifacts import Metric, Protocol
from inpaint3d.report.charts import Line, line_chart
from inpaint3d.report.page import DOUBT_MARKER, RUN_MARKER, render
from inpaint3d.stages.evaluation.scores import KINDS, Score, find_best

SHOWN_BY_VIEW = ("psnr", "lpips_vgg")
STOPS = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Curve:
    """PSNR of a field under `held-out-samples` while it was trained: (step, dB)."""

    label: str
    points: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Strip:
    """Panels side by side in one PNG, with a caption for each."""

    view: str
    file: Path
    captions: Sequence[str]


@dataclass(frozen=True)
class Report:
    """All that the page shows."""

    title: str
    hole: str
    protocols: Sequence[Protocol]
    contact: Strip
    strips: Sequence[Strip]
    curves: Sequence[Curve]
    notes: Sequence[str]
    non_finite: dict[str, int]
    health: dict[str, dict[str, float]] = field(default_factory=dict[str, dict[str, float]])
    """Field -> counters of its fit."""
    rows: Sequence[Score] = ()
    """Figures of single views."""


def write_report(path: Path, report: Report) -> None:
    """Render the page; pictures are embedded, and two lines mark where the run's doubts and times go."""
    page = render(
        "inpaint3d.stages.evaluation",
        "report.html.j2",
        report=report,
        tables=[_make_table(p) for p in report.protocols],
        by_view=_list_views(report.rows),
        chart=line_chart(
            [Line(c.label, c.points) for c in report.curves],
            "training step",
            "PSNR, held-out-samples, dB",
            min_y_span=0.5,
        ),
        stop_heads=["field", *(f"at {share:.0%} of the steps" for share in STOPS), "at the end"],
        stopping=[row for curve in report.curves if (row := cost_of_stopping_early(curve)) is not None],
        embedded=_embed,
        doubt_marker=DOUBT_MARKER,
        run_marker=RUN_MARKER,
    )
    path.write_text(page, encoding="utf-8")


def cost_of_stopping_early(curve: Curve) -> tuple[str, list[float | None], float] | None:
    """(label, PSNR at 25, 50 and 75 % of the steps minus the last, last PSNR); None without two measured points.

    The figure at a share of the steps is the last one measured by then, None where there was none.
    """
    if len(curve.points) < 2:
        return None
    last_step, last = curve.points[-1]
    costs: list[float | None] = []
    for share in STOPS:
        before = [y for x, y in curve.points if x <= share * last_step]
        costs.append(before[-1] - last if before else None)
    return curve.label, costs, last


@dataclass(frozen=True)
class _Cell:
    text: str
    best: bool = False
    about: str = ""
    """How sure it is, in small print."""


def _make_table(protocol: Protocol) -> dict[str, object]:
    """Rows by method and columns by figure, as text; a figure that a method lacks is a dash."""
    names = [n for n in KINDS if any(m.name == n for m in protocol.metrics)]
    winners = find_best(protocol.metrics)
    values = {(m.method, m.name): m for m in protocol.metrics}
    rows = []
    for method in dict.fromkeys(m.method for m in protocol.metrics):
        cells = [
            _make_cell(values[method, n], best=(method, n) in winners) if (method, n) in values else _Cell("–")
            for n in names
        ]
        rows.append((method, cells))
    heads = ["method", *((KINDS[n].title, _describe_unit(n)) for n in names)]
    return {
        "name": protocol.name,
        "version": protocol.version,
        "description": protocol.description,
        "conditions": _list_conditions(protocol),
        "heads": heads,
        "rows": rows,
    }


def _list_conditions(protocol: Protocol) -> dict[str, str]:
    told = {
        "crop": protocol.crop,
        "resolution": protocol.resolution,
        "colours": protocol.colour_range,
        "networks": ", ".join(protocol.networks),
        "n": "" if protocol.views is None else f"{protocol.views} views",
    }
    return {name: value for name, value in told.items() if value}


def _make_cell(m: Metric, *, best: bool) -> _Cell:
    digits = KINDS[m.name].digits
    about = [] if m.low is None else [f"{m.low:.{digits}f} to {m.high:.{digits}f}"]
    about += [] if m.standard_error is None else [f"± {m.standard_error:.{digits}f}"]
    about += [f"{m.equal_views} views equal"] if m.equal_views else []
    return _Cell(f"{m.value:.{digits}f}", best, ", ".join(about))


def _list_views(rows: Sequence[Score]) -> list[dict[str, object]]:
    """A table for each protocol: views by method, with the figures of `SHOWN_BY_VIEW`."""
    tables: list[dict[str, object]] = []
    for protocol in dict.fromkeys(r.protocol for r in rows):
        own = {(r.view, r.method, r.metric): r.value for r in rows if r.protocol == protocol}
        columns = list(dict.fromkeys((m, n) for _, m, n in own if n in SHOWN_BY_VIEW))
        views = dict.fromkeys(v for v, _, _ in own)
        if columns:
            cells = {v: [_write_value(own.get((v, m, n)), n) for m, n in columns] for v in views}
            heads = ["view", *((m, KINDS[n].title) for m, n in columns)]
            tables.append({"name": protocol, "heads": heads, "cells": cells})
    return tables


def _write_value(value: float | None, name: str) -> str:
    if value is None:
        return "–"
    return f"{value:.{KINDS[name].digits}f}" if math.isfinite(value) else "equal"


def _describe_unit(name: str) -> str:
    unit = KINDS[name].unit
    return f"{'' if unit == '1' else f'{unit}, '}{KINDS[name].better} is better"


def _embed(file: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()
