"""`inpaint3d`: run a pipeline over captures, and look at what came out.

Exit codes are those of `inpaint3d.contracts.errors`: 0 done, 2 configuration, 3 bad input, 4 waiting for a person,
5 storage, 75 retryable, 143 stopped, 1 anything else.
"""

import contextlib
import dataclasses
import json
import os
import sys
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from inpaint3d.contracts.errors import ConfigurationError, Inpaint3dError, from_os_error
from inpaint3d.contracts.models.cluster import Image, ImagesSpec
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.dataset import DATASETS, SceneScore, find_scenes, read_figures, tabulate
from inpaint3d.orchestrator.effects import find_analysis, read_effects
from inpaint3d.orchestrator.intake import list_scenes, name_run
from inpaint3d.orchestrator.options import (
    AcceptDoubtful,
    AsJson,
    Budget,
    Capture,
    Engine,
    Environment,
    LogFormat,
    Name,
    PipelinePath,
    Places,
    Replace,
    Request,
    Scene,
    SceneRequest,
    ShowEffects,
    Wait,
    with_options,
)
from inpaint3d.orchestrator.plan import Planner, Selection, find_pipeline, preview
from inpaint3d.orchestrator.progress import PROGRESS, Recorded, choose_display
from inpaint3d.orchestrator.publish import REPORT, publish, read_report
from inpaint3d.orchestrator.request import ConfiguredRequest
from inpaint3d.orchestrator.run import Scheduler
from inpaint3d.orchestrator.run_folder import check_capture, own_folder
from inpaint3d.orchestrator.runners.container import ContainerRunner, find_engine
from inpaint3d.orchestrator.runners.process import ProcessRunner, Runner
from inpaint3d.orchestrator.saved_mask import command_to_edit, path_of, use_saved
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


def _load_images(environment: Environment) -> Mapping[str, Image] | None:
    """The images whose digests stand for the stages' code, where stages run in them."""
    return None if environment.runner == "process" else load_document(environment.images, ImagesSpec)[0].spec


@app.command()
@with_options
def run(
    capture: Capture,
    request: SceneRequest,
    selection: Selection,
    environment: Environment,
    places: Places,
    budget: Budget,
    name: Name = None,
    scene: Scene = None,
    engine: Engine = None,
    log_format: LogFormat = "auto",
    wait: Wait = False,
    replace: Replace = False,
    accept_doubtful: AcceptDoubtful = False,
) -> None:
    """Run the pipeline over a capture; what is up to date is not run again. Killed, the next run goes on."""

    def run_once(asked: SceneRequest, chosen: Selection, accept: bool) -> int:
        return _run_scenes(
            capture, asked, chosen, environment, places, name=name, scene=scene, engine=engine, log_format=log_format,
            wait=wait, replace=replace, accept_doubtful=accept or accept_doubtful,
        )  # fmt: skip

    if budget.is_set:
        from inpaint3d.orchestrator.budget.run import run_within

        if scene or selection != Selection():
            raise ConfigurationError("a budget is for one whole scene; leave out --scene, --only, --from and --until")
        raise typer.Exit(run_within(budget, request, places.runs_dir / name_run(capture, name), run_once))
    raise typer.Exit(run_once(request, selection, False))


def _run_scenes(
    capture: Path,
    request: SceneRequest,
    selection: Selection,
    environment: Environment,
    places: Places,
    *,
    name: str | None,
    scene: list[str] | None,
    engine: str | None,
    log_format: str,
    wait: bool,
    replace: bool,
    accept_doubtful: bool,
) -> int:
    """Run every scene that is asked for; the gravest exit code."""
    scenes = list_scenes(capture, scene, name)
    folders = [places.runs_dir / name_run(path, scene_name) for path, scene_name in scenes]
    requests = [ConfiguredRequest(use_saved(request, folder), selection) for folder in folders]
    store, images = open_store(places.store), _load_images(environment)
    runner = ProcessRunner() if images is None else ContainerRunner(find_engine(engine), images)
    codes: list[int] = []
    for (path, scene_name), folder, configured in zip(scenes, folders, requests, strict=True):
        with own_folder(folder, wait=wait), store.shared():
            planner = configured.planner(store, path, scene_name, images)
            check_capture(planner, replace=replace)
            record, code = _carry_out(planner, selection, folder, log_format, runner, accept_doubtful=accept_doubtful)
        if record.status == "waiting":
            _say(f"{record.name}: `{command_to_edit(record.name, places)}` opens a page for it; then run this again")
        codes.append(code)
        if record.status == "stopped":
            break  # whoever stopped this scene meant the others too
    return max(codes)


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
    configured, store = ConfiguredRequest(asked, Selection()), open_store(places.store)
    scores: list[SceneScore] = []
    codes: list[int] = []
    for path in found:
        results = places.runs_dir / f"{dataset}-{path.name}"
        with own_folder(results), store.shared():
            planner = configured.planner(store, path, results.name)
            record, code = _carry_out(planner, Selection(), results, log_format, ProcessRunner())
        codes.append(code)
        scores.append(read_figures(path.name, read_report(results)) if code == 0 else SceneScore(path.name))
        if record.status == "stopped":
            break
    table = tabulate(known, scores)
    (places.runs_dir / f"{dataset}.json").write_text(json.dumps(table, indent=2) + "\n")
    show_scores(table)
    raise typer.Exit(max(codes))


def _carry_out(
    planner: Planner,
    selection: Selection,
    folder: Path,
    log_format: str,
    runner: Runner,
    *,
    accept_doubtful: bool = False,
) -> tuple[RunRecord, int]:
    """Run, leave results in the folder, say how it ended; the record and the exit code."""
    if planner.mask is not None and planner.mask == path_of(folder):
        _say(f"{planner.name}: what is to go is what {planner.mask} says")
    if left_out := planner.configured.left_out:
        said = ", ".join(f"{node} ({reason})" for node, reason in left_out.items())
        _say(f"{planner.name}: left out: {said}")
    display = Recorded(choose_display(log_format, planner.pipeline.order), folder / PROGRESS)
    command = ("inpaint3d", *sys.argv[1:])
    scheduler = Scheduler(planner, selection, display, folder, runner, accept_doubtful=accept_doubtful, command=command)
    remove(folder / REPORT)  # a run that is killed leaves none: that of an earlier one would speak for it
    try:
        record = scheduler.run()
    except BaseException:
        with contextlib.suppress(Inpaint3dError, OSError):  # why the run ended counts, not what could not be shown
            publish(planner.store, scheduler.record, folder)
        raise
    publish(planner.store, record, folder)
    code = _conclude(record, folder)
    _say(f"Report: {folder / REPORT}")
    return record, code


def _say(line: str) -> None:
    sys.stderr.write(printable(line) + "\n")


def _conclude(record: RunRecord, folder: Path) -> int:
    """Say how a run ended, on standard error; returns its exit code."""
    ran = [n.node for n in record.nodes if n.status == "done"]
    failed = [n for n in record.nodes if n.status in ("failed", "waiting", "stopped")]
    if record.status == "done":
        what = f"ran {', '.join(ran)}" if ran else "nothing to be done: everything is up to date"
        _say(f"{record.name}: {what}. Results: {folder}")
        return 0
    for node in failed:
        _say(f"{record.name}: {node.node} {node.status}: {node.error}")
    if failed:
        return max(n.exit_code or 1 for n in failed)
    blocked = [f"{n.node} ({n.reason})" for n in record.nodes if n.status == "pending"]
    repair = "run again to go on" if record.status == "stopped" else "run those first, or leave out --only and --from"
    _say(f"{record.name}: {record.status}; not run: {', '.join(blocked)}; {repair}")
    return 143 if record.status == "stopped" else ConfigurationError.exit_code


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
    folder, store = places.runs_dir / name_run(capture, name), open_store(places.store)
    configured = ConfiguredRequest(use_saved(request, folder), selection)
    if effects:
        code = _plan_effects(configured, store, capture, name, folder, environment, as_json=as_json)
        raise typer.Exit(code)
    planner = configured.planner(store, capture, name, _load_images(environment))
    show_nodes(preview(planner, selection), as_json=as_json)


def _plan_effects(
    configured: ConfiguredRequest,
    store: Store,
    capture: Path,
    name: str | None,
    folder: Path,
    environment: Environment,
    *,
    as_json: bool,
) -> int:
    """Run what the effects are decided by, print them; returns the exit code."""
    until = Selection(until=find_analysis(configured.pipeline.pipeline))
    images = _load_images(environment)
    runner = ProcessRunner() if images is None else ContainerRunner(find_engine(None), images)
    with own_folder(folder), store.shared():
        planner = configured.planner(store, capture, name, images)
        record, code = _carry_out(planner, until, folder, "auto", runner)
    show_effects(read_effects(store, record), as_json=as_json)
    return code


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
