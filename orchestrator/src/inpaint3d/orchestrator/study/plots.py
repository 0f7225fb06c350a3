"""Fronts of a study as SVG, and a table with the command of each point."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from inpaint3d.orchestrator.study.points import Point, StudyResults, find_front
from inpaint3d.orchestrator.study.space import write_value

STYLE: Any = {"svg.hashsalt": "inpaint3d", "svg.fonttype": "none", "font.size": 9}


@dataclass(frozen=True)
class Plot:
    """Gain against cost over the points that have both. `sign` is -1 where less is better."""

    file: str
    title: str
    x: str
    y: str
    cost: Callable[[Point], float]
    gain: Callable[[Point], float | None]
    sign: int = 1


def list_plots(results: StudyResults) -> list[Plot]:
    """End to end: time and memory against PSNR and LPIPS; and each stage that makes a field by itself."""
    cpu, memory = "CPU seconds after the cameras", "peak memory, MiB"
    psnr, lpips = f"PSNR, dB ({results.protocol})", f"LPIPS, VGG ({results.protocol})"
    ends = [
        Plot("psnr-time.svg", "PSNR and time", cpu, psnr, Point.sum_seconds, lambda p: p.figures.get("psnr")),
        Plot("lpips-time.svg", "LPIPS and time", cpu, lpips, Point.sum_seconds, _read_lpips, -1),
        Plot("psnr-memory.svg", "PSNR and memory", memory, psnr, _read_memory, lambda p: p.figures.get("psnr")),
    ]  # fmt: skip
    fields = dict.fromkeys(n for p in results.points for n, c in p.stages.items() if c.held_out_psnr is not None)
    return ends + [_plot_stage(node) for node in fields]


def _plot_stage(node: str) -> Plot:
    return Plot(
        f"{node}.svg", node, "CPU seconds of the stage", "PSNR of held-out pixels, dB",
        lambda p: p.stages[node].cpu_s if node in p.stages else 0.0,
        lambda p: p.stages[node].held_out_psnr if node in p.stages else None,
    )  # fmt: skip


def _read_lpips(point: Point) -> float | None:
    return point.figures.get("lpips_vgg")


def _read_memory(point: Point) -> float:
    return point.peak_memory_bytes / 2**20


def write_pages(results: StudyResults, folder: Path) -> None:
    """Every plot that has two points or more, and `table.md`."""
    draw_plots(results, folder)
    (folder / "table.md").write_text(tabulate(results))


def draw_plots(results: StudyResults, folder: Path) -> list[Plot]:
    """The plots that have two points or more, drawn into a folder."""
    plots = [plot for plot in list_plots(results) if len(_list_measured(results, plot)) > 1]
    for plot in plots:
        draw(results, plot, folder / plot.file)
    return plots


def _list_measured(results: StudyResults, plot: Plot) -> list[Point]:
    return [p for p in results.points if p.stages and plot.gain(p) is not None]


def draw(results: StudyResults, plot: Plot, path: Path) -> None:
    """One SVG: all points, the front as a line, presets by name."""
    import matplotlib
    from matplotlib.figure import Figure

    points = _list_measured(results, plot)
    front = find_front(points, plot.cost, lambda p: plot.sign * (plot.gain(p) or 0.0))
    mpl: Any = matplotlib  # its stubs are only partly typed
    with mpl.rc_context(STYLE):
        figure: Any = Figure(figsize=(6.4, 3.6), layout="constrained")
        axes = figure.add_subplot()
        axes.scatter([plot.cost(p) for p in points], [plot.gain(p) or 0.0 for p in points], s=18, c="#8aa0a8")
        at = [(plot.cost(p), plot.gain(p) or 0.0) for p in front]
        axes.step(*zip(*at, strict=True), where="post", color="#0b6e8f", marker="o", ms=4, label="nothing beats these")
        for point in points:
            if not point.knobs:
                axes.annotate(point.name, (plot.cost(point), plot.gain(point) or 0.0), textcoords="offset points",
                              xytext=(5, -10), color="#c8553d")  # fmt: skip
        axes.set(title=plot.title, xlabel=plot.x, ylabel=plot.y)
        axes.grid(alpha=0.3)
        axes.legend(frameon=False)
        figure.savefig(path, format="svg", metadata={"Date": None})


def tabulate(results: StudyResults, pictures: str = "") -> str:
    """Markdown: what was measured on, every finished point by its time, and the command of each on the front.

    pictures: Markdown that stands before the table.
    """
    front = find_front(results.measured, Point.sum_seconds, lambda p: p.figures["psnr"])
    counts = {s: sum(p.state == s for p in results.points) for s in ("done", "stopped-early", "failed")}
    machine = results.machine
    lines = [
        f"Capture `{results.capture}`, protocol `{results.protocol}`"
        + (f", {machine.processor}, {machine.cores} cores" if machine else "")
        + f"; {counts['done']} points measured, {counts['stopped-early']} stopped early, {counts['failed']} failed.",
        "",
        *([pictures, ""] if pictures else []),
        "| point | on the front | CPU s after the cameras | wall s | peak MiB | PSNR | SSIM | LPIPS (VGG) | knobs |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for p in sorted(results.measured, key=Point.sum_seconds):
        scores = " | ".join(f"{p.figures[n]:.{d}f}" if n in p.figures else "–" for n, d in _FIGURES)
        knobs = ", ".join(f"{name} {write_value(value)}" for name, value in p.knobs.items()) or f"preset {p.preset}"
        lines.append(
            f"| {p.name} | {'yes' if p in front else ''} | {p.sum_seconds():.0f} | {p.sum_seconds('wall_s'):.0f} "
            f"| {_read_memory(p):.0f} | {scores} | {knobs} |"
        )
    lines += ["", "What nothing beats, as commands:", "", "```"]
    return "\n".join([*lines, *(p.command for p in front), "```", ""])


_FIGURES = (("psnr", 2), ("ssim", 3), ("lpips_vgg", 3))
