"""The part of the report that knows of time: what each stage cost, and what stopping earlier would have cost."""

import html
from collections.abc import Sequence
from typing import Any

from inpaint3d.contracts.models.report import NodeRun, RunRecord
from inpaint3d.contracts.store import Store

WIDTH, HEIGHT, MARGIN = 460, 200, 44
Row = dict[str, Any]


def render_times(store: Store, record: RunRecord) -> str:
    """HTML: machine, stages with times and reasons, and for each learning curve accuracy against seconds."""
    machine = record.machine
    where = f"{machine.processor}, {machine.cores} cores, {machine.memory_bytes / 2**30:.0f} GiB"
    parts = [
        '<section id="run"><h2>Time and accuracy</h2>',
        f"<p>Preset <b>{html.escape(record.preset or 'none')}</b>, on {html.escape(where)}.</p>",
        _stage_table(record.nodes),
        _non_finite(record.nodes),
    ]
    for node in record.nodes:
        if node.key is not None and (found := store.lookup(node.key, verify=False)) is not None:
            for name, rows in found.timings.get("series", {}).items():
                parts.append(_curve_section(node.node, name, rows))
    return "\n".join([*parts, "</section>"])


def _stage_table(nodes: Sequence[NodeRun]) -> str:
    rows = "".join(
        f"<tr><td>{n.node}</td><td>{n.status}</td><td>{_number(n.wall_s)}</td><td>{_number(n.cpu_s)}</td>"
        f"<td>{_number(None if n.peak_memory_bytes is None else n.peak_memory_bytes / 2**20, 0)}</td>"
        f"<td>{html.escape(n.reason)}</td></tr>"
        for n in nodes
    )
    head = "<tr><th>stage</th><th>state</th><th>wall s</th><th>CPU s</th><th>peak MiB</th><th>why</th></tr>"
    note = "<p>Times of a cached stage are those of the run that computed it.</p>"
    return f"<table>{head}{rows}</table>{note}"


def _non_finite(nodes: Sequence[NodeRun]) -> str:
    met = {f"{n.node}: {place}": count for n in nodes for place, count in n.non_finite.items() if count}
    if not met:
        return "<p>No stage met a non-finite value.</p>"
    items = "".join(f"<li>{html.escape(place)}: {count}</li>" for place, count in met.items())
    return f"<p><b>Non-finite values were met:</b></p><ul>{items}</ul>"


def _curve_section(node: str, name: str, rows: list[Row]) -> str:
    """Accuracy against time of one series, where it has a figure that grows or falls with the work."""
    figure = next((f for f in ("psnr", "held_out_psnr", "held_out_loss", "loss") if any(f in r for r in rows)), None)
    points = [(float(r["wall_s"]), float(r["cpu_s"]), float(r[figure])) for r in rows if figure and figure in r]
    if figure is None or len(points) < 2:
        return ""
    wall, _, last = points[-1]
    earlier = "".join(
        f"<tr><td>{share:.0%}</td><td>{p[0]:.0f}</td><td>{p[1]:.0f}</td>"
        f"<td>{p[2]:.3g}</td><td>{p[2] - last:+.3g}</td></tr>"
        for share in (0.25, 0.5, 0.75, 1.0)
        for p in [min(points, key=lambda q: abs(q[0] - share * wall))]
    )
    table = (
        "<table><tr><th>stopped at</th><th>wall s</th><th>CPU s</th>"
        f"<th>{figure}</th><th>against the end</th></tr>{earlier}</table>"
    )
    title = html.escape(f"{node}: {name.replace('_', ' ')} ({figure})")
    return f"<h3>{title}</h3>{_plot([(w, v) for w, _, v in points], 'wall s', figure)}{table}"


def _plot(points: list[tuple[float, float]], x_name: str, y_name: str) -> str:
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    low, high = min(ys), max(ys)
    span_x, span_y = (max(xs) or 1.0), (high - low) or 1.0
    wide, tall = (WIDTH - 2 * MARGIN) / span_x, (HEIGHT - 2 * MARGIN) / span_y
    place = [f"{MARGIN + wide * x:.1f},{HEIGHT - MARGIN - tall * (y - low):.1f}" for x, y in points]
    return (
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" role="img" aria-label="{y_name} against {x_name}">'
        f'<line x1="{MARGIN}" y1="{HEIGHT - MARGIN}" x2="{WIDTH - MARGIN}" y2="{HEIGHT - MARGIN}" stroke="#888"/>'
        f'<line x1="{MARGIN}" y1="{MARGIN}" x2="{MARGIN}" y2="{HEIGHT - MARGIN}" stroke="#888"/>'
        f'<polyline points="{" ".join(place)}" fill="none" stroke="#2563eb" stroke-width="2"/>'
        f'<g font-size="11" fill="#666"><text x="{WIDTH - MARGIN}" y="{HEIGHT - MARGIN + 16}" text-anchor="end">'
        f'{max(xs):.0f} {x_name}</text><text x="{MARGIN - 6}" y="{MARGIN}" text-anchor="end">{high:.3g}</text>'
        f'<text x="{MARGIN - 6}" y="{HEIGHT - MARGIN}" text-anchor="end">{low:.3g}</text></g></svg>'
    )


def _number(value: float | None, digits: int = 1) -> str:
    return "" if value is None else f"{value:.{digits}f}"
