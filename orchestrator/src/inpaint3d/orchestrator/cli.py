"""`inpaint3d`: run a pipeline over captures, and look at what came out.

Exit codes are those of `inpaint3d.contracts.errors`: 0 done, 2 configuration, 3 bad input, 4 waiting for a person,
5 storage, 75 retryable, 143 stopped, 1 anything else.
"""

import dataclasses
import json
import os
import sys
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from inpaint3d.contracts.errors import ConfigurationError, Inpaint3dError, from_os_error
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.dataset import DATASETS, SceneScore, find_scenes, read_figures, tabulate
from inpaint3d.orchestrator.effects import find_analysis, read_effects
from inpaint3d.orchestrator.intake import list_scenes, name_run
from inpaint3d.orchestrator.options import (
    AsJson,
    Budget,
    Capture,
    Environment,
    Execution,
    LogFormat,
    Name,
    PipelinePath,
    Places,
    Request,
    Scene,
    SceneRequest,
    ShowEffects,
    with_options,
)
from inpaint3d.orchestrator.plan import Selection, find_pipeline, preview
from inpaint3d.orchestrator.publish import read_report
from inpaint3d.orchestrator.request import ConfiguredRequest
from inpaint3d.orchestrator.saved_mask import use_saved
from inpaint3d.orchestrator.scenes import SceneRunner, run_scenes
from inpaint3d.orchestrator.tables import printable, show_effects, show_nodes, show_scores

app = typer.Typer(
    no_args_is_help=True,
    help="3D scene inpainting as a pipeline of stages.",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(asked: bool) -> None:
    if asked:
        sys.stdout.write(f"inpaint3d {metadata.version('inpaint3d-orchestrator')}\n")
        raise typer.Exit


@app.callback()
def inpaint3d(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version, and end.")
    ] = False,
) -> None:
    """3D scene inpainting as a pipeline of stages."""


def main() -> None:
    """Entry point: every foreseen error becomes one clear message and its documented exit code."""
    # What is started most often does not wait for the imports of the other commands.
    if sys.argv[1:2] not in ([name] for name in ("run", "plan", "validate")):
        add_other_commands()
    try:
        app(standalone_mode=True)
    except Inpaint3dError as error:
        _fail(error)
    except OSError as error:
        _fail(from_os_error(error))


def _fail(error: Inpaint3dError) -> None:
    sys.stderr.write(printable(f"inpaint3d: {error.kind}: {error}\n"))
    try:
        sys.stdout.flush()
    except BrokenPipeError:  # nobody reads it: what is left of it goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(error.exit_code)


@app.command()
@with_options
def run(
    capture: Capture,
    request: SceneRequest,
    selection: Selection,
    environment: Environment,
    places: Places,
    budget: Budget,
    execution: Execution,
    name: Name = None,
    scene: Scene = None,
) -> None:
    """Run the pipeline over a capture; what is up to date is not run again. Killed, the next run goes on."""
    scenes = list_scenes(capture, scene, name)

    def run_once(asked: SceneRequest, chosen: Selection, accept: bool) -> int:
        accepting = dataclasses.replace(execution, accept_doubtful=accept or execution.accept_doubtful)
        return run_scenes(SceneRunner(places, environment, accepting), asked, chosen, scenes)

    if budget.is_set:
        from inpaint3d.orchestrator.budget.run import run_within

        if scene or selection != Selection():
            raise ConfigurationError("a budget is for one whole scene; leave out --scene, --only, --from and --until")
        raise typer.Exit(run_within(budget, request, places.runs_dir / name_run(capture, name), run_once))
    raise typer.Exit(run_once(request, selection, False))


@app.command("evaluate-dataset")
@with_options
def evaluate_dataset(
    dataset: Annotated[str, typer.Argument(help=f"one of {', '.join(DATASETS)}")],
    folder: Annotated[Path, typer.Argument(help="folder of the data set's scenes, one subfolder each")],
    request: Request,
    places: Places,
    scene: Scene = None,
    log_format: LogFormat = "auto",
) -> None:
    """Run every scene of a data set under its preset, and print its table beside the published one.

    The table is also written to DATASET.json below --runs-dir. A scene that fails is left out of the means and decides
    the exit code; the others are run all the same.
    """
    if dataset not in DATASETS:
        raise ConfigurationError(f"no data set {dataset}; there are {', '.join(DATASETS)}")
    known, found = DATASETS[dataset], find_scenes(DATASETS[dataset], folder, scene)
    asked = dataclasses.replace(request, preset=request.preset or known.preset)
    configured = ConfiguredRequest(asked, Selection())
    # The names are the data set's: another copy of it takes them over.
    runner = SceneRunner(places, Environment(), Execution(log_format=log_format, replace=True))
    scores: list[SceneScore] = []
    codes: list[int] = []
    for path in found:
        record, code = runner.run(configured, Selection(), (path, f"{dataset}-{path.name}"))
        codes.append(code)
        report = None if code else read_report(places.runs_dir / record.name)
        scores.append(SceneScore(path.name) if report is None else read_figures(path.name, report))
        if record.status == "stopped":
            break
    table = tabulate(known, scores)
    (places.runs_dir / f"{dataset}.json").write_text(json.dumps(table, indent=2) + "\n")
    show_scores(table)
    raise typer.Exit(max(codes))


@app.command()
@with_options
def plan(
    capture: Capture,
    request: SceneRequest,
    selection: Selection,
    environment: Environment,
    places: Places,
    name: Name = None,
    effects: ShowEffects = False,
    as_json: AsJson = False,
) -> None:
    """Say what `run` would do and why, stage by stage, without doing it.

    With --effects, run up to the analysis of the scene, and print what it calls for before anything is trained.
    """
    scene = (capture, name)
    # Whether the name may be taken over is asked by the run, not by its plan.
    runner = SceneRunner(places, environment, Execution(replace=True))
    configured = ConfiguredRequest(use_saved(request, runner.folder(scene)), selection)
    if not effects:
        show_nodes(preview(runner.planner(configured, scene), selection), as_json=as_json)
        return
    until = Selection(until=find_analysis(configured.pipeline.pipeline))
    record, code = runner.run(configured, until, scene)
    show_effects(read_effects(runner.store, record), as_json=as_json)
    raise typer.Exit(code)


@app.command()
def validate(pipeline: PipelinePath = None) -> None:
    """Check pipeline.yaml and every stage.yaml it names."""
    checked = Pipeline(find_pipeline(pipeline))
    names = [
        f"{name} (under {', '.join(presets)})" if (presets := checked.nodes[name].presets) else name
        for name in checked.order
    ]
    sys.stdout.write(f"{checked.path}: {len(names)} stages: {', '.join(names)}\n")


def add_other_commands() -> typer.Typer:
    """The program with the commands of all modules."""
    from inpaint3d.orchestrator import (
        cluster_cli,
        dev_cli,
        history_cli,
        masks_cli,
        paint_cli,
        params_cli,
        study_cli,
        view_cli,
    )

    app.add_typer(cluster_cli.emit_app, name="emit")
    app.add_typer(dev_cli.dev_app, name="dev")
    app.add_typer(masks_cli.masks_app, name="masks")
    app.add_typer(paint_cli.paint_app, name="paint")
    cluster_cli.add_to(app)
    history_cli.add_to(app)
    params_cli.add_to(app)
    study_cli.add_to(app)
    view_cli.add_to(app)
    return app
