"""The commands that look at what there is: past runs, their results, the store."""

import contextlib
import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.page_server import Get, PageServer
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import EffectFigures
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.orchestrator import comparison, housekeeping
from inpaint3d.orchestrator.history import History, name_status
from inpaint3d.orchestrator.options import RUNS, STORE, AsJson, PipelinePath, RunsPath, StorePath
from inpaint3d.orchestrator.pages.run_list import RunList
from inpaint3d.orchestrator.pages.side_by_side import render_comparison
from inpaint3d.orchestrator.plan import find_pipeline
from inpaint3d.orchestrator.provenance import find_unproved
from inpaint3d.orchestrator.publish import publish, read_report
from inpaint3d.orchestrator.run_folder import own_folder
from inpaint3d.orchestrator.tables import print_table, printable, show_effects, show_nodes


def add_to(app: typer.Typer) -> None:
    """Make the commands part of `inpaint3d`."""
    for command in (why, runs, show, verify, compare, gc, lineage):
        app.command()(command)
    app.command(name="publish")(publish_again)


def why(name: str, stage: str, store: StorePath = STORE) -> None:
    """Say why a stage ran, or did not, in the last run of NAME: which part of its key changed, old -> new."""
    record = History(open_store(store)).latest(name)
    found = [n for n in record.nodes if n.node == stage]
    if not found:
        raise ConfigurationError(f"no stage {stage} in {name}; there are {', '.join(n.node for n in record.nodes)}")
    sys.stdout.write(printable(f"{stage}: {found[0].status}: {found[0].reason}\n"))
    for change in found[0].changes:
        sys.stdout.write(f"  {change.component}: {json.dumps(change.old)} -> {json.dumps(change.new)}\n")
    if found[0].error:
        sys.stdout.write(printable(f"  {found[0].error}\n"))


def runs(
    store: StorePath = STORE,
    runs_dir: RunsPath = RUNS,
    as_json: AsJson = False,
    serve: Annotated[
        bool, typer.Option("--serve", help="show them on a local page, as they go on; until Ctrl-C")
    ] = False,
    port: Annotated[int, typer.Option(help="with --serve; default: any that is free")] = 0,
) -> None:
    """List the runs that the store remembers, the newest of each name first."""
    if serve:
        serve_pages(RunList(open_store(store), runs_dir).get, port)
        return
    history = History(open_store(store))
    records = [r for name in history.names() for r in history.of(name)]
    if as_json:
        told = [r.model_dump(mode="json", exclude={"nodes"}) | {"status": name_status(r)} for r in records]
        sys.stdout.write(json.dumps(told, indent=2) + "\n")
        return
    rows: list[list[str]] = []
    for r in records:
        counts = [sum(n.status == s for n in r.nodes) for s in ("done", "cached")]
        wall = "" if r.wall_s is None else f"{r.wall_s:.1f}"
        rows.append([r.name, r.started[:19], name_status(r), r.preset or "", wall, *map(str, counts)])
    print_table(("name", "started", "status", "preset", "wall s", "ran", "cached"), rows)


def serve_pages(get: Get, port: int) -> None:
    """Say where pages are served, and serve them until Ctrl-C."""
    with PageServer(get, port=port) as server, contextlib.suppress(KeyboardInterrupt):
        server.announce_and_serve()


def show(name: str, runs_dir: RunsPath = RUNS, store: StorePath = STORE, as_json: AsJson = False) -> None:
    """Print a run's metrics, stages and times; with --json, its metrics.json."""
    if not (runs_dir / name / "metrics.json").is_file():
        History(open_store(store)).latest(name)  # says which names there are
        raise ConfigurationError(f"{runs_dir / name} holds no results; run it again, or give its --runs-dir")
    report = read_report(runs_dir / name)
    if as_json:
        sys.stdout.write(json.dumps(report, indent=2) + "\n")
        return
    show_nodes(list(History(open_store(store)).latest(name).nodes), as_json=False)
    if effects := [EffectFigures.model_validate(e) for e in report.get("effects", [])]:
        sys.stdout.write("\n")
        show_effects(effects)
    if course := report.get("course"):
        sys.stdout.write(printable(f"\naccuracy and time: {course['sentence']}\n"))
    for protocol in report["protocols"]:
        sys.stdout.write(f"\n{protocol['name']}: {protocol['description']}\n")
        rows = [
            (m["method"], m["name"], f"{m['value']:.4g}", m["unit"], m["better"], str(m["views"]))
            for m in protocol["metrics"]
        ]
        print_table(("method", "metric", "value", "unit", "better", "views"), rows)


def verify(
    store: StorePath = STORE,
    repair: Annotated[
        bool, typer.Option("--repair", help="put what is bad in quarantine, to be computed again")
    ] = False,
    provenance: Annotated[
        str | None, typer.Option(metavar="RUN", help="prove what the last run of this name was made from, instead")
    ] = None,
) -> None:
    """Hash every artifact, key record and listing in the store, and say what is bad or gone.

    Exit codes: 0 nothing bad, or all of it mended; 3 something bad is left, or not proved.
    """
    if provenance is not None:
        _prove(open_store(store), provenance)
        return
    found = list(housekeeping.find_damage(open_store(store)))
    for damage in found:
        sys.stdout.write(printable(damage.what) + "\n")
        if repair and damage.mend is not None:
            damage.mend()
    left = [d for d in found if not repair or d.mend is None]
    sys.stderr.write(f"{len(found)} damaged, {len(found) - len(left)} mended")
    sys.stderr.write("; `inpaint3d verify --repair` mends what can be\n" if left and not repair else "\n")
    raise typer.Exit(BadInputError.exit_code if left else 0)


def _prove(store: Store, name: str) -> None:
    record = History(store).latest(name)
    unproved = list(find_unproved(store, record))
    for what in unproved:
        sys.stdout.write(printable(what) + "\n")
    nodes = [n for n in record.nodes if n.status in ("done", "cached")]
    if unproved:
        raise BadInputError(f"{name}: {len(unproved)} things are not what its record says; run it again")
    sys.stderr.write(printable(f"{name}: {len(nodes)} results follow from {', '.join(record.externals)}\n"))


def compare(
    name: str,
    other: str,
    store: StorePath = STORE,
    other_store: Annotated[str | None, typer.Option(help="where OTHER's artifacts are kept; default: --store")] = None,
    pipeline: PipelinePath = None,
    page: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="also write pictures, figures and times side by side")
    ] = None,
) -> None:
    """Say whether the last runs of NAME and OTHER made the same artifacts, whatever ran them; 3 where not."""
    one, two = open_store(store), open_store(other_store or store)
    records = History(one).latest(name), History(two).latest(other)
    rows = list(comparison.compare(Pipeline(find_pipeline(pipeline)), one, records[0], two, records[1]))
    if page is not None:
        page.write_text(render_comparison((one, records[0]), (two, records[1]), rows))
    print_table(("stage", "output", "", ""), [(r.node, r.port, r.verdict, r.detail) for r in rows], width=140)
    raise typer.Exit(0 if all(r.verdict in ("equal", "may differ") for r in rows) else BadInputError.exit_code)


def gc(
    store: StorePath = STORE,
    keep: Annotated[int, typer.Option(min=1, help="runs to keep of each name")] = 1,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="only say what would go")] = False,
) -> None:
    """Remove what no kept run needs: old artifacts, keys, checkpoints, quarantine.

    Exit codes: 3 a run's record cannot be read, so that what it needs is not known; 75 a run is using the store.
    Nothing is removed then.
    """
    freed, count = housekeeping.collect(open_store(store), keep=keep, dry_run=dry_run)
    verb = "would free" if dry_run else "freed"
    sys.stdout.write(f"{verb} {freed / 2**20:.1f} MiB in {count} artifacts\n")


def lineage(name: str, stage: str = "usd-export", store: StorePath = STORE) -> None:
    """Print what a stage's result in the last run of NAME was made from, back to the photos."""
    opened = open_store(store)
    for line in housekeeping.trace_lineage(opened, History(opened).latest(name), stage):
        sys.stdout.write(printable(line) + "\n")


def publish_again(name: str, runs_dir: RunsPath = RUNS, store: StorePath = STORE) -> None:
    """Leave the results of the last run of NAME, wherever it ran, in runs/NAME/ here.

    Exit codes: 0 the run did all it was for; else as that of the run, 3 where it does not say why it failed.
    """
    opened = open_store(store)
    record = History(opened).latest(name)
    with own_folder(runs_dir / name):
        publish(opened, record, runs_dir / name)
    sys.stderr.write(printable(f"{name}: {record.status}; results: {runs_dir / name}\n"))
    if record.status != "done":
        raise typer.Exit(max((n.exit_code or 0 for n in record.nodes), default=0) or BadInputError.exit_code)
