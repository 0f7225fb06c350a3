"""Protocols as tables: a row for each method, a column for each figure, the best of each marked."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

from inpaint3d.contracts.models.artifacts import Metric, Protocol


@dataclass(frozen=True)
class Cell:
    """A figure as text; a dash where a method lacks it."""

    text: str
    best: bool = False


@dataclass(frozen=True)
class MetricTable:
    """`heads`: (title, unit and which way is better) of each figure."""

    title: str
    description: str
    heads: list[tuple[str, str]]
    rows: list[tuple[str, list[Cell]]]


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
    return MetricTable(protocol.name.replace("-", " ").capitalize(), protocol.description, heads, rows)


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
    return Cell("–") if metric is None else Cell(f"{metric.value:.{metric.digits}f}", best)


def _describe_unit(metric: Metric) -> str:
    return f"{'' if metric.unit == '1' else f'{metric.unit}, '}{metric.better} is better"


def _rate_merit(m: Metric) -> float:
    if m.better == "nearer 1":
        return -abs(math.log(max(m.value, 1e-12)))
    return m.value if m.better == "higher" else -m.value
