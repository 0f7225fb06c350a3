"""The HTML report: one file that needs nothing beside it."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import jinja2

from inpaint3d.contracts.models.artifacts import Protocol
from inpaint3d.stages.evaluation.charts import Line, line_chart
from inpaint3d.stages.evaluation.scores import KINDS, find_best

RUN_MARKER = "<!-- inpaint3d:run -->"
STOPS = (0.25, 0.5, 0.75)


@dataclass(frozen=True)
class Curve:
    """Held-out PSNR of a field while it was trained: (step, dB)."""

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


def write_report(path: Path, report: Report) -> None:
    """Render the page; pictures are embedded, and one line marks where the run's times go."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.from_string(
        resources.files("inpaint3d.stages.evaluation").joinpath("report.html.j2").read_text("utf-8")
    )
    page = template.render(
        report=report,
        tables=[_table(p) for p in report.protocols],
        chart=line_chart([Line(c.label, c.points) for c in report.curves], "training step", "held-out PSNR, dB"),
        stops=STOPS,
        stopping=[row for curve in report.curves if (row := cost_of_stopping_early(curve)) is not None],
        embedded=_embed,
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
    best: bool


def _table(protocol: Protocol) -> dict[str, object]:
    """Rows by method and columns by figure, as text; a figure that a method lacks is a dash."""
    names = [n for n in KINDS if any(m.name == n for m in protocol.metrics)]
    winners = find_best(protocol.metrics)
    values = {(m.method, m.name): m for m in protocol.metrics}
    rows = []
    for method in dict.fromkeys(m.method for m in protocol.metrics):
        cells = [
            _Cell(f"{values[method, n].value:.{KINDS[n].digits}f}", (method, n) in winners)
            if (method, n) in values
            else _Cell("–", False)
            for n in names
        ]
        rows.append((method, cells))
    heads = [(KINDS[n].title, KINDS[n].unit if KINDS[n].unit != "1" else "", KINDS[n].better) for n in names]
    return {"name": protocol.name, "description": protocol.description, "heads": heads, "rows": rows}


def _embed(file: Path) -> str:
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode()
