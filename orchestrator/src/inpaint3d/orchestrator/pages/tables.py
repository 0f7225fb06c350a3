"""Protocols as tables: a row for each method, a column for each figure, the best of each marked; and view by view."""

import csv
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from inpaint3d.contracts.models.artifacts import Metric, Protocol


@dataclass(frozen=True)
class Cell:
    """A figure as text, a dash where a method lacks it; about: how sure it is, in small print."""

    text: str
    best: bool = False
    about: str = ""


@dataclass(frozen=True)
class MetricTable:
    """`heads`: (title, unit and which way is better) of each figure; conditions: under which it was measured."""

    title: str
    description: str
    conditions: dict[str, str]
    heads: list[tuple[str, str]]
    rows: list[tuple[str, list[Cell]]]


@dataclass(frozen=True)
class ViewTable:
    """Figures of single views: `heads` are (method, figure), a row for each view."""

    title: str
    heads: list[tuple[str, str]]
    rows: list[tuple[str, list[str]]]


SHOWN_BY_VIEW = ("psnr", "lpips_vgg")


def make_table(protocol: Protocol) -> MetricTable:
    """A protocol's figures by method."""
    figures = {m.name: m for m in reversed(protocol.metrics)}
    names = list(dict.fromkeys(m.name for m in protocol.metrics))
    winners = find_best(protocol.metrics)
    values = {(m.method, m.name): m for m in protocol.metrics}
    rows = [
        (method, [_make_cell(values.get((method, name)), (method, name) in winners) for name in names])
        for method in dict.fromkeys(m.method for m in protocol.metrics)
    ]
    heads = [(figures[n].title or n, _describe_unit(figures[n])) for n in names]
    title = f"{protocol.name}, version {protocol.version}"
    return MetricTable(title, protocol.description, _list_conditions(protocol), heads, rows)


def list_views(per_view: Path, protocols: Sequence[Protocol]) -> list[ViewTable]:
    """A table for each protocol with figures of `SHOWN_BY_VIEW`; per_view: an evaluation's table of all views."""
    with per_view.open(newline="") as file:
        found = [row for row in csv.DictReader(file) if row["metric"] in SHOWN_BY_VIEW]
    tables: list[ViewTable] = []
    for protocol in protocols:
        own = {
            (r["view"], r["method"], r["metric"]): float(r["value"]) for r in found if r["protocol"] == protocol.name
        }
        kinds = {m.name: m for m in protocol.metrics}
        columns = [(m, n) for m, n in dict.fromkeys((m, n) for _, m, n in own) if n in kinds]
        if columns:
            rows = [
                (view, [_write_value(own.get((view, m, n)), kinds[n].digits) for m, n in columns])
                for view in dict.fromkeys(view for view, _, _ in own)
            ]
            tables.append(ViewTable(protocol.name, [(m, kinds[n].title or n) for m, n in columns], rows))
    return tables


def find_best(metrics: Iterable[Metric]) -> set[tuple[str, str]]:
    """(method, name) of the best figure of each name; all of them where several are equal, none of one alone."""
    by_name: dict[str, list[Metric]] = {}
    for m in metrics:
        by_name.setdefault(m.name, []).append(m)
    winners: set[tuple[str, str]] = set()
    for name, group in by_name.items():
        top = max(_rate_merit(m) for m in group)
        winners |= {(m.method, name) for m in group if _rate_merit(m) == top} if len(group) > 1 else set()
    return winners


def _make_cell(metric: Metric | None, best: bool) -> Cell:
    if metric is None:
        return Cell("–")
    digits = metric.digits
    about = [] if metric.low is None else [f"{metric.low:.{digits}f} to {metric.high:.{digits}f}"]
    about += [] if metric.standard_error is None else [f"± {metric.standard_error:.{digits}f}"]
    about += [f"{metric.equal_views} views equal"] if metric.equal_views else []
    return Cell(f"{metric.value:.{digits}f}", best, ", ".join(about))


def _list_conditions(protocol: Protocol) -> dict[str, str]:
    told = {
        "crop": protocol.crop,
        "resolution": protocol.resolution,
        "colours": protocol.colour_range,
        "networks": ", ".join(protocol.networks),
        "n": "" if protocol.views is None else f"{protocol.views} views",
    }
    return {name: value for name, value in told.items() if value}


def _write_value(value: float | None, digits: int) -> str:
    if value is None:
        return "–"
    return f"{value:.{digits}f}" if math.isfinite(value) else "equal"


def _describe_unit(metric: Metric) -> str:
    return f"{'' if metric.unit == '1' else f'{metric.unit}, '}{metric.better} is better"


def _rate_merit(m: Metric) -> float:
    if m.better == "nearer 1":
        return -abs(math.log(max(m.value, 1e-12)))
    return m.value if m.better == "higher" else -m.value
