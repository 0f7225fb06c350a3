"""Two runs side by side, as a page that stands alone."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path

from inpaint3d.contracts.models.artifacts import Metric
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.comparison import Row
from inpaint3d.orchestrator.pages.dag import format_seconds
from inpaint3d.orchestrator.pages.pictures import Strip
from inpaint3d.orchestrator.pages.report import PACKAGE, Page, write_policy
from inpaint3d.orchestrator.pages.verdict import find_metrics, judge
from inpaint3d.orchestrator.plan import find_differences
from inpaint3d.report.page import render


@dataclass(frozen=True)
class Figure:
    """A figure of both results; `better` names the run that has the better one, where one has."""

    protocol: str
    title: str
    values: tuple[str, str]
    difference: str
    better: int | None


def render_comparison(one: tuple[Store, RunRecord], other: tuple[Store, RunRecord], rows: Sequence[Row]) -> str:
    """The page: verdicts, the view that shows the hole best, figures, times, what each was asked, artifacts."""
    pages = [Page(store, record, Path()) for store, record in (one, other)]
    script = (files(PACKAGE) / "report.js").read_text()
    return render(
        PACKAGE,
        "side_by_side.html.j2",
        records=[page.record for page in pages],
        verdicts=[judge(p.record, p.evaluation.metadata if p.evaluation else None) for p in pages],
        contacts=_name_apart([page.contact for page in pages]),
        figures=list(_pair_figures(*pages)),
        times=list(_pair_times(*(page.record for page in pages))),
        asked=list(_list_asked(*(page.record for page in pages))),
        rows=rows,
        script=script,
        policy=write_policy(script),
    )


def _name_apart(contacts: list[Strip | None]) -> list[Strip] | None:
    """Both pictures, under ids of their own; None where one is missing."""
    found = [replace(c, id=f"contact-{i}") for i, c in enumerate(contacts) if c is not None and len(c.panels) > 2]
    return found if len(found) == len(contacts) else None


def _pair_figures(one: Page, other: Page) -> Iterator[Figure]:
    """Figures that both results have under one protocol."""
    if one.evaluation is None or other.evaluation is None:
        return
    for protocol in one.evaluation.metadata.protocols:
        theirs = {m.name: m for m in find_metrics(other.evaluation.metadata, protocol.name)}
        for mine in find_metrics(one.evaluation.metadata, protocol.name):
            if twin := theirs.get(mine.name):
                values = (f"{mine.value:.{mine.digits}f}", f"{twin.value:.{mine.digits}f}")
                difference = f"{twin.value - mine.value:+.{mine.digits}f}"
                name = protocol.name.replace("-", " ")
                yield Figure(name, mine.title or mine.name, values, difference, _find_better(mine, twin))


def _find_better(mine: Metric, twin: Metric) -> int | None:
    if mine.better not in ("higher", "lower") or mine.value == twin.value:
        return None
    return int((twin.value > mine.value) == (mine.better == "higher"))


def _pair_times(one: RunRecord, other: RunRecord) -> Iterator[tuple[str, str, str, str, str]]:
    """(stage, state and wall time in each)."""
    there = {n.node: n for n in other.nodes}
    for n in one.nodes:
        twin = there.get(n.node)
        if n.status == "left-out" and (twin is None or twin.status == "left-out"):
            continue
        seconds = ["–" if r is None or r.wall_s is None else format_seconds(r.wall_s) for r in (n, twin)]
        yield n.node, n.status, seconds[0], "left-out" if twin is None else twin.status, seconds[1]


def _list_asked(one: RunRecord, other: RunRecord) -> Iterator[tuple[str, str, str, str]]:
    """(stage, parameter or seed, value in each) of what the runs were asked differently."""
    there = {n.node: n for n in other.nodes}
    for n in one.nodes:
        if (twin := there.get(n.node)) is None or not (n.components and twin.components):
            continue
        was, now = ({k: r.components.get(k) for k in ("parameters", "seed", "device")} for r in (n, twin))
        yield from ((n.node, c.component, str(c.old), str(c.new)) for c in find_differences(was, now))
