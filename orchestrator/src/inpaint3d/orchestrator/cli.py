"""`inpaint3d`: run a pipeline over captures, and look at what came out.

Exit codes are those of `inpaint3d.contracts.errors`: 0 done, 2 configuration, 3 bad input, 4 waiting for a person,
5 storage, 75 retryable, 143 stopped, 1 anything else.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, Inpaint3dError, from_os_error
from inpaint3d.contracts.models.cluster import Image, ImagesSpec
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import NodeRun, RunRecord
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.orchestrator import cluster_cli, dev_cli, housekeeping
from inpaint3d.orchestrator import compare as comparison
from inpaint3d.orchestrator.dataset import DATASETS, SceneScore, figures_of, scenes_in, table_of
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import run_name, scenes_of, take_externals
from inpaint3d.orchestrator.options import (
    IMAGES,
    RUNS,
    STORE,
    AsJson,
    Capture,
    Corpus,
    Device,
    Engine,
    Force,
    From,
    Images,
    LogFormat,
    Mask,
    Name,
    Only,
    PipelinePath,
    Preset,
    Prior,
    RunnerName,
    RunsPath,
    Scene,
    Seed,
    Set,
    StorePath,
    Stub,
    Until,
)  # fmt: skip
from inpaint3d.orchestrator.parameters import parse_overrides
from inpaint3d.orchestrator.plan import Planner, Selection, find_pipeline, preview
from inpaint3d.orchestrator.progress import display_for
from inpaint3d.orchestrator.publish import publish, read_report
from inpaint3d.orchestrator.run import Scheduler
from inpaint3d.orchestrator.runners.container import ContainerRunner, find_engine
from inpaint3d.orchestrator.runners.process import ProcessRunner, Runner

app = typer.Typer(no_args_is_help=True, add_completion=False, help="3D scene inpainting as a pipeline of stages.")


def main() -> None:
    """Entry point: every foreseen error becomes one clear message and its documented exit code."""
    try:
        app(standalone_mode=True)
    except Inpaint3dError as error:
        _fail(error)
    except OSError as error:
        _fail(from_os_error(error))


def _fail(error: Inpaint3dError) -> None:
    sys.stderr.write(f"inpaint3d: {error.kind}: {error}\n")
    sys.exit(error.exit_code)


def _planner(
    capture: Path,
    *,
    store: Store,
    pipeline: Pipeline,
    name: str | None,
    mask: Path | None,
    preset: str | None,
    assignments: list[str] | None,
    prior: Path | None,
    corpus: Path | None,
    seed: int,
    device: str,
    stub: bool,
    images: Mapping[str, Image] | None = None,
) -> Planner:
    preset = preset or pipeline.spec.spec.defaultPreset
    chosen = pipeline.under(preset)
    return Planner(
        pipeline=chosen,
        store=store,
        history=History(store),
        name=run_name(capture, name),
        preset=preset,
        externals=take_externals(store, chosen, capture, mask=mask, prior=prior, corpus=corpus),
        overrides=parse_overrides(chosen, assignments or []),
        seed=seed,
        device=device,
        stub=stub,
        images=images,
    )


def _images(runner: str, file: Path) -> Mapping[str, Image] | None:
    """The images whose digests stand for the stages' code, where stages run in them."""
    return None if runner == "process" else load_document(file, ImagesSpec)[0].spec


@app.command()
def run(
    capture: Capture,
    mask: Mask = None,
    preset: Preset = None,
    name: Name = None,
    scene: Scene = None,
    only: Only = None,
    start: From = None,
    until: Until = None,
    force: Force = False,
    assignments: Set = None,
    prior: Prior = None,
    corpus: Corpus = None,
    seed: Seed = 0,
    device: Device = "cpu",
    stub: Stub = False,
    runner: RunnerName = "process",
    engine: Engine = None,
    images: Images = IMAGES,
    store: StorePath = STORE,
    runs_dir: RunsPath = RUNS,
    pipeline: PipelinePath = None,
    log_format: LogFormat = "auto",
) -> None:
    """Run the pipeline over a capture; what is up to date is not run again. Killed, the next run goes on."""
    checked, opened = Pipeline(find_pipeline(pipeline)), open_store(store)
    built = _images(runner, images)
    chosen = ProcessRunner() if built is None else ContainerRunner(find_engine(engine), built)
    codes: list[int] = []
    for path, scene_name in scenes_of(capture, scene, name):
        with opened.shared():
            planner = _planner(
                path, store=opened, pipeline=checked, name=scene_name, mask=mask, preset=preset,
                assignments=assignments, prior=prior, corpus=corpus, seed=seed, device=device, stub=stub, images=built,
            )  # fmt: skip
            selection = Selection(only=only, start=start, until=until, force=force)
            record, code = _carry_out(planner, selection, runs_dir / planner.name, log_format, chosen)
        codes.append(code)
        if record.status == "stopped":
            break  # whoever stopped this scene meant the others too
    raise typer.Exit(max(codes))


@app.command("evaluate-dataset")
def evaluate_dataset(
    dataset: Annotated[str, typer.Argument(help=f"one of {', '.join(DATASETS)}")],
    folder: Annotated[Path, typer.Argument(help="folder of the data set's scenes, one subfolder each")],
    preset: Preset = None,
    scene: Scene = None,
    assignments: Set = None,
    prior: Prior = None,
    corpus: Corpus = None,
    seed: Seed = 0,
    device: Device = "cpu",
    stub: Stub = False,
    store: StorePath = STORE,
    runs_dir: RunsPath = RUNS,
    pipeline: PipelinePath = None,
    log_format: LogFormat = "auto",
) -> None:
    """Run every scene of a data set under its preset, and print its table beside the published one.

    The table is also written to DATASET.json below --runs-dir. A scene that fails is left out of the means and decides
    the exit code; the others are run all the same.
    """
    if dataset not in DATASETS:
        raise ConfigurationError(f"no data set {dataset}; there are {', '.join(DATASETS)}")
    known, found = DATASETS[dataset], scenes_in(DATASETS[dataset], folder, scene)
    checked, opened = Pipeline(find_pipeline(pipeline)), open_store(store)
    scores: list[SceneScore] = []
    codes: list[int] = []
    for path in found:
        with opened.shared():
            planner = _planner(
                path, store=opened, pipeline=checked, name=f"{dataset}-{path.name}", mask=None,
                preset=preset or known.preset, assignments=assignments, prior=prior, corpus=corpus, seed=seed,
                device=device, stub=stub,
            )  # fmt: skip
            record, code = _carry_out(planner, Selection(), runs_dir / planner.name, log_format, ProcessRunner())
        codes.append(code)
        done = code == 0
        scores.append(figures_of(path.name, read_report(runs_dir / planner.name)) if done else SceneScore(path.name))
        if record.status == "stopped":
            break
    table = table_of(known, scores)
    (runs_dir / f"{dataset}.json").write_text(json.dumps(table, indent=2) + "\n")
    _show_table(table)
    raise typer.Exit(max(codes))


def _show_table(table: dict[str, Any]) -> None:
    """The rows of `table_of`, and under them how each scene was scored."""
    shown = Table("scene", "method", "views", *table["metrics"], box=None)
    for row in (*table["scenes"], table["mean"], *table["published"]):
        values = ["" if (v := row["figures"].get(name)) is None else f"{v:.4g}" for name in table["metrics"]]
        views = "" if row.get("views") is None else str(row["views"])
        shown.add_row(row["name"], row.get("method") or "", views, *values)
    Console(width=140).print(shown)
    for row in table["scenes"]:
        sys.stdout.write(f"\n{row['name']}: {row['protocol'] or 'failed; see above'}\n")


def _carry_out(
    planner: Planner, selection: Selection, folder: Path, log_format: str, runner: Runner
) -> tuple[RunRecord, int]:
    """Run, leave results in the folder, say how it ended; the record and the exit code."""
    scheduler = Scheduler(planner, selection, display_for(log_format, planner.pipeline.order), folder, runner)
    record = scheduler.run()
    publish(planner.store, record, folder)
    return record, _conclude(record, folder)


def _conclude(record: RunRecord, folder: Path) -> int:
    """Say how a run ended, on standard error; returns its exit code."""
    ran = [n.node for n in record.nodes if n.status == "done"]
    failed = [n for n in record.nodes if n.status in ("failed", "waiting", "stopped")]
    if record.status == "done":
        what = f"ran {', '.join(ran)}" if ran else "nothing to be done: everything is up to date"
        sys.stderr.write(f"{record.name}: {what}. Results: {folder}\n")
        return 0
    for node in failed:
        sys.stderr.write(f"{record.name}: {node.node} {node.status}: {node.error}\n")
    if failed:
        return max(n.exit_code or 1 for n in failed)
    blocked = [f"{n.node} ({n.reason})" for n in record.nodes if n.status == "pending"]
    repair = "run again to go on" if record.status == "stopped" else "run those first, or leave out --only and --from"
    sys.stderr.write(f"{record.name}: {record.status}; not run: {', '.join(blocked)}; {repair}\n")
    return 143 if record.status == "stopped" else ConfigurationError.exit_code


@app.command()
def plan(
    capture: Capture,
    mask: Mask = None,
    preset: Preset = None,
    name: Name = None,
    only: Only = None,
    start: From = None,
    until: Until = None,
    force: Force = False,
    assignments: Set = None,
    prior: Prior = None,
    corpus: Corpus = None,
    seed: Seed = 0,
    device: Device = "cpu",
    stub: Stub = False,
    runner: RunnerName = "process",
    images: Images = IMAGES,
    store: StorePath = STORE,
    pipeline: PipelinePath = None,
    as_json: AsJson = False,
) -> None:
    """Say what `run` would do and why, stage by stage, without doing it."""
    planner = _planner(
        capture, store=open_store(store), pipeline=Pipeline(find_pipeline(pipeline)), name=name, mask=mask,
        preset=preset, assignments=assignments, prior=prior, corpus=corpus, seed=seed, device=device, stub=stub,
        images=_images(runner, images),
    )  # fmt: skip
    _show_nodes(preview(planner, Selection(only=only, start=start, until=until, force=force)), as_json=as_json)


@app.command()
def why(name: str, stage: str, store: StorePath = STORE) -> None:
    """Say why a stage ran, or did not, in the last run of NAME: which part of its key changed, old -> new."""
    record = History(open_store(store)).latest(name)
    found = [n for n in record.nodes if n.node == stage]
    if not found:
        raise ConfigurationError(f"no stage {stage} in {name}; there are {', '.join(n.node for n in record.nodes)}")
    sys.stdout.write(f"{stage}: {found[0].status}: {found[0].reason}\n")
    for change in found[0].changes:
        sys.stdout.write(f"  {change.component}: {json.dumps(change.old)} -> {json.dumps(change.new)}\n")
    if found[0].error:
        sys.stdout.write(f"  {found[0].error}\n")


@app.command()
def runs(store: StorePath = STORE, as_json: AsJson = False) -> None:
    """List the runs that the store remembers, the newest of each name first."""
    history = History(open_store(store))
    records = [r for name in history.names() for r in history.of(name)]
    if as_json:
        sys.stdout.write(json.dumps([r.model_dump(mode="json", exclude={"nodes"}) for r in records], indent=2) + "\n")
        return
    table = Table("name", "started", "status", "preset", "wall s", "ran", "cached", box=None)
    for r in records:
        counts = [sum(n.status == s for n in r.nodes) for s in ("done", "cached")]
        wall = "" if r.wall_s is None else f"{r.wall_s:.1f}"
        table.add_row(r.name, r.started[:19], r.status, r.preset or "", wall, *map(str, counts))
    Console().print(table)


@app.command()
def show(name: str, runs_dir: RunsPath = RUNS, store: StorePath = STORE, as_json: AsJson = False) -> None:
    """Print a run's metrics, stages and times; with --json, its metrics.json."""
    if not (runs_dir / name / "metrics.json").is_file():
        History(open_store(store)).latest(name)  # says which names there are
        raise ConfigurationError(f"{runs_dir / name} holds no results; run it again, or give its --runs-dir")
    report = read_report(runs_dir / name)
    if as_json:
        sys.stdout.write(json.dumps(report, indent=2) + "\n")
        return
    _show_nodes(list(History(open_store(store)).latest(name).nodes), as_json=False)
    for protocol in report["protocols"]:
        sys.stdout.write(f"\n{protocol['name']}: {protocol['description']}\n")
        table = Table("method", "metric", "value", "unit", "better", "views", box=None)
        for m in protocol["metrics"]:
            table.add_row(m["method"], m["name"], f"{m['value']:.4g}", m["unit"], m["better"], str(m["views"]))
        Console().print(table)


def _show_nodes(nodes: list[NodeRun], *, as_json: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps([n.model_dump(mode="json") for n in nodes], indent=2) + "\n")
        return
    table = Table("stage", "state", "wall s", "CPU s", "peak MiB", "why", box=None)
    for n in nodes:
        memory = "" if n.peak_memory_bytes is None else f"{n.peak_memory_bytes / 2**20:.0f}"
        figures = ["" if v is None else f"{v:.1f}" for v in (n.wall_s, n.cpu_s)]
        changes = "".join(f"\n  {c.component}: {json.dumps(c.old)} -> {json.dumps(c.new)}" for c in n.changes)
        table.add_row(n.node, n.status, *figures, memory, n.reason + changes)
    Console().print(table)


@app.command()
def verify(store: StorePath = STORE) -> None:
    """Hash every artifact in the store; bad ones are put in quarantine and will be computed again."""
    damaged = housekeeping.verify(open_store(store))
    for line in damaged:
        sys.stdout.write(line + "\n")
    sys.stderr.write(f"{len(damaged)} damaged artifacts\n")
    raise typer.Exit(3 if damaged else 0)


@app.command()
def compare(
    name: str,
    other: str,
    store: StorePath = STORE,
    other_store: Annotated[str | None, typer.Option(help="where OTHER's artifacts are kept; default: --store")] = None,
    pipeline: PipelinePath = None,
) -> None:
    """Say whether the last runs of NAME and OTHER made the same artifacts, whatever ran them; 3 where not."""
    one, two = open_store(store), open_store(other_store or store)
    rows = list(
        comparison.compare(
            Pipeline(find_pipeline(pipeline)), one, History(one).latest(name), two, History(two).latest(other)
        )
    )
    table = Table("stage", "output", "", "", box=None)
    for row in rows:
        table.add_row(row.node, row.port, row.verdict, row.detail)
    Console(width=140).print(table)
    raise typer.Exit(0 if all(r.verdict in ("equal", "may differ") for r in rows) else BadInputError.exit_code)


@app.command()
def gc(
    store: StorePath = STORE,
    keep: Annotated[int, typer.Option(min=1, help="runs to keep of each name")] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only say what would go")] = False,
) -> None:
    """Remove what no kept run needs: old artifacts, keys, checkpoints, quarantine."""
    freed, count = housekeeping.collect(open_store(store), keep=keep, dry_run=dry_run)
    verb = "would free" if dry_run else "freed"
    sys.stdout.write(f"{verb} {freed / 2**20:.1f} MiB in {count} artifacts\n")


@app.command()
def lineage(name: str, stage: str = "usd-export", store: StorePath = STORE) -> None:
    """Print what a stage's result in the last run of NAME was made from, back to the photos."""
    opened = open_store(store)
    for line in housekeeping.lineage(opened, History(opened).latest(name), stage):
        sys.stdout.write(line + "\n")


@app.command()
def validate(pipeline: PipelinePath = None) -> None:
    """Check pipeline.yaml and every stage.yaml it names."""
    checked = Pipeline(find_pipeline(pipeline))
    names = [
        f"{name} (under {', '.join(presets)})" if (presets := checked.nodes[name].presets) else name
        for name in checked.order
    ]
    sys.stdout.write(f"{checked.path}: {len(names)} stages: {', '.join(names)}\n")


@app.command(name="publish")
def publish_again(name: str, runs_dir: RunsPath = RUNS, store: StorePath = STORE) -> None:
    """Leave the results of the last run of NAME, wherever it ran, in runs/NAME/ here."""
    opened = open_store(store)
    publish(opened, History(opened).latest(name), runs_dir / name)
    sys.stderr.write(f"{name}: results: {runs_dir / name}\n")


app.add_typer(cluster_cli.emit_app, name="emit")
app.add_typer(dev_cli.dev_app, name="dev")
cluster_cli.add_to(app)
