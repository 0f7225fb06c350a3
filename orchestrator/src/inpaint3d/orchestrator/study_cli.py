"""`inpaint3d study`: what accuracy costs in time and memory on a capture."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from inpaint3d.orchestrator.options import Capture, Mask, Places, Stub, with_options
from inpaint3d.orchestrator.plan import find_pipeline
from inpaint3d.orchestrator.study.points import Point
from inpaint3d.orchestrator.study.space import load_study
from inpaint3d.orchestrator.study.sweep import Bed, sweep
from inpaint3d.orchestrator.tables import printable

STUDY = "study.yaml"


def add_to(app: typer.Typer) -> None:
    """Make the command part of `inpaint3d`."""
    app.command()(study)


@with_options
def study(
    capture: Capture,
    places: Places,
    mask: Mask = None,
    points: Annotated[int, typer.Option(min=0, help="points of the design, those of earlier calls included")] = 20,
    knobs: Annotated[Path | None, typer.Option(help="what is varied; default: study.yaml beside the pipeline")] = None,
    out: Annotated[
        Path | None, typer.Option(help="folder of points.json, plots, table; default: RUNS/study-CAPTURE")
    ] = None,
    seed: Annotated[int, typer.Option(help="of the design")] = 0,
    stub: Stub = False,
) -> None:
    """Measure what accuracy costs: settings of the pipeline over one capture, their fronts, plots and a table.

    Points share work through the store; stopped, the next call goes on with the points that are missing.
    """
    from inpaint3d.orchestrator.study.plots import write_pages

    spec = load_study(knobs or find_pipeline(None).with_name(STUDY))
    folder = out or places.runs_dir / f"study-{capture.resolve().name}"
    bed = Bed(capture, mask, places.store, places.runs_dir, folder, stub)
    for point in sweep(spec, bed, points, seed):
        sys.stderr.write(printable(f"{describe(point)}\n"))
    write_pages(bed.load_results(), folder)
    sys.stderr.write(f"results: {folder}\n")


def describe(point: Point) -> str:
    """A point in a line."""
    if point.error is not None:
        return f"{point.name}: failed: {point.error}"
    figures = ", ".join(f"{name} {value:.4g}" for name, value in point.figures.items() if name in ("psnr", "lpips_vgg"))
    return f"{point.name}: {point.state}, {point.sum_seconds():.0f} CPU s after the cameras{figures and ', ' + figures}"
