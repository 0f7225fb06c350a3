"""The commands that have to do with a cluster."""

import datetime
import json
import sys
import time
from pathlib import Path
from typing import Annotated, Any

import typer

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, WaitingError
from inpaint3d.contracts.models.cluster import ClusterSpec, ImagesSpec, Scene, Submission
from inpaint3d.contracts.models.documents import load_document, read_document
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.untrusted import UntrustedError, parse_yaml_documents
from inpaint3d.contracts.store import open_store
from inpaint3d.orchestrator import cluster as clusters
from inpaint3d.orchestrator.emit.argo import AWAIT
from inpaint3d.orchestrator.emit.check import check
from inpaint3d.orchestrator.emit.documents import dump
from inpaint3d.orchestrator.intake import MASK_REQUEST, PAINTED, list_scenes, name_run
from inpaint3d.orchestrator.options import (
    IMAGES,
    STORE,
    AcceptDoubtful,
    Capture,
    Images,
    PipelinePath,
    SceneRequest,
    StorePath,
    with_options,
)
from inpaint3d.orchestrator.options import (
    Scene as Scenes,
)
from inpaint3d.orchestrator.plan import Selection, find_pipeline
from inpaint3d.orchestrator.request import ConfiguredRequest
from inpaint3d.orchestrator.tables import print_table, printable
from inpaint3d.orchestrator.workflows import Row, is_over, list_rows

emit_app = typer.Typer(no_args_is_help=True, help="Manifests for a cluster, and what is wrong with some.")

Cluster = Annotated[Path, typer.Option("--cluster", envvar="INPAINT3D_CLUSTER", help="cluster.yaml: where to run")]
AwaitMasks = Annotated[
    bool, typer.Option("--await-masks", help="wait before mask-authoring for somebody to author one")
]
AwaitPaintings = Annotated[
    bool, typer.Option("--await-paintings", help="wait before view-completion for somebody to paint views")
]
SubmissionName = Annotated[str | None, typer.Option("--name", help="default: the capture's folder name")]
CLUSTER = Path("cluster.yaml")
WATCH_S = 10.0


def add_to(app: typer.Typer) -> None:
    """Make the commands part of `inpaint3d`."""
    for command in (submit, status, logs, rerun, record):
        app.command()(command)
    app.command(name="give-mask")(give_mask)
    app.command(name="give-painting")(give_painting)


def _cluster(path: Path) -> ClusterSpec:
    return load_document(path, ClusterSpec)[0]


@emit_app.command()
@with_options
def argo(
    capture: Capture,
    request: SceneRequest,
    name: SubmissionName = None,
    scene: Scenes = None,
    await_masks: AwaitMasks = False,
    await_paintings: AwaitPaintings = False,
    accept_doubtful: AcceptDoubtful = False,
    cluster: Cluster = CLUSTER,
    images: Images = IMAGES,
    replace: Annotated[bool, typer.Option("--replace", help="what was emitted under the name before")] = False,
) -> None:
    """Write a WorkflowTemplate and Workflows for Argo to standard output, for `submit`; captures go to the store."""
    where, configured = _cluster(cluster), ConfiguredRequest(request, Selection())
    store = open_store(where.spec.store)
    scenes = [(path, name_run(path, given)) for path, given in list_scenes(capture, scene, None)]
    submission = Submission(
        name=name_run(capture, name).lower().replace("_", "-"),
        preset=configured.pipeline.preset,
        overrides=configured.overrides,
        compare=request.compare,
        seed=request.seed,
        device=request.device,
        stub=request.stub,
        want=tuple(request.want or ()),
        awaitMasks=await_masks,
        awaitPaintings=await_paintings,
        acceptDoubtful=accept_doubtful,
        images=load_document(images, ImagesSpec)[0].spec,
        scenes=tuple(Scene(name=n, externals=configured.take_externals(store, p)) for p, n in scenes),
    )
    sys.stdout.write(dump(clusters.prepare(store, configured.whole, where, submission, replace=replace)))


@emit_app.command(name="check")
def check_file(manifest: Path, pipeline: PipelinePath = None) -> None:
    """Say what is wrong with manifests, as far as that can be known without a cluster."""
    _conclude(check(_parse_documents(manifest), Pipeline(find_pipeline(pipeline))))


def _parse_documents(manifest: Path) -> list[Any]:
    try:
        return parse_yaml_documents(read_document(manifest))
    except UntrustedError as error:
        raise ConfigurationError(f"{manifest}: {error}; give what `inpaint3d emit argo` wrote") from error


def _conclude(findings: list[str]) -> None:
    for finding in findings:
        sys.stdout.write(finding + "\n")
    if findings:
        raise ConfigurationError(f"{len(findings)} things are wrong with these manifests; emit them again")


def submit(manifest: Path, cluster: Cluster = CLUSTER, pipeline: PipelinePath = None) -> None:
    """Give what `emit argo` wrote to the cluster that kubectl is pointed at; what the store has is not run again."""
    documents = _parse_documents(manifest)
    _conclude(check(documents, Pipeline(find_pipeline(pipeline))))
    _say_each(clusters.submit(_cluster(cluster), documents))


def status(
    name: str,
    cluster: Cluster = CLUSTER,
    watch: Annotated[bool, typer.Option("--watch", help="again and again, until all is over")] = False,
) -> None:
    """Say where each stage of each scene of a submission stands.

    Exit codes: 0 all is well so far; 3 something failed; 4 something waits for a mask, or an image that is not there.
    """
    while True:
        workflows = clusters.list_workflows(_cluster(cluster), name)
        now = datetime.datetime.now(datetime.UTC)
        rows = [row for workflow in workflows for row in list_rows(workflow, now)]
        print_table(
            ("scene", "stage", "phase", "seconds", "tries", "message"), map(_describe, rows), wrapped=("message",)
        )
        for workflow in workflows:
            sys.stdout.write(printable(f"{workflow['metadata']['name']}: {clusters.phase_of(workflow)}\n"))
        if not watch or all(map(is_over, workflows)):
            break
        time.sleep(WATCH_S)
    phases = {row.phase for row in rows} | {clusters.phase_of(workflow) for workflow in workflows}
    if phases & {"Failed", "Error"}:
        raise typer.Exit(BadInputError.exit_code)
    if "NoImage" in phases or any(row.stage in AWAIT.values() and row.phase == "Running" for row in rows):
        raise typer.Exit(WaitingError.exit_code)


def _describe(row: Row) -> list[str]:
    seconds = "" if row.seconds is None else f"{row.seconds:.0f}"
    return [row.scene, row.stage, row.phase, seconds, str(row.tries), row.message]


def logs(
    name: str,
    stage: Annotated[str | None, typer.Option(help="of this stage alone")] = None,
    cluster: Cluster = CLUSTER,
) -> None:
    """Print what the pods of a submission said."""
    for line in clusters.logs(_cluster(cluster), name, stage):
        sys.stdout.write(line)


def rerun(
    name: str,
    stage: Annotated[str, typer.Option(help="what to compute again")],
    scene: Annotated[list[str] | None, typer.Option(help="of this scene alone; may be repeated")] = None,
    cluster: Cluster = CLUSTER,
    pipeline: PipelinePath = None,
) -> None:
    """Compute one stage of a submission again, and what then changes behind it."""
    where = _cluster(cluster)
    store, checked = open_store(where.spec.store), Pipeline(find_pipeline(pipeline))
    _say_each(clusters.rerun(store, checked, where, name, stage, scene or []))


def _say_each(workflows: dict[str, str]) -> None:
    for workflow, what in workflows.items():
        sys.stdout.write(f"{workflow}: {what}\n")


def record(
    name: str,
    scenes: Annotated[str | None, typer.Option(help="of these alone: a Workflow's JSON list of scenes")] = None,
    since: Annotated[str | None, typer.Option(help="when the Workflow was made (RFC 3339)")] = None,
    store: StorePath = STORE,
    pipeline: PipelinePath = None,
) -> None:
    """Write the record of every scene of a submission to the store: the exit handler of a Workflow."""
    began = None if since is None else _read_time(since)
    opened = open_store(store)
    submission = clusters.load_submission(opened, name)
    if scenes is not None:
        names = {scene["name"] for scene in json.loads(scenes)}
        if gone := sorted(names - {s.name for s in submission.scenes}):
            raise ConfigurationError(f"{name} has no scene {', '.join(gone)}: it was emitted again with other scenes")
        submission = submission.model_copy(update={"scenes": tuple(s for s in submission.scenes if s.name in names)})
    for run in clusters.record(opened, Pipeline(find_pipeline(pipeline)), submission, began):
        sys.stdout.write(f"{run.name}: {run.status}\n")


def _read_time(text: str) -> datetime.datetime:
    """An RFC 3339 time; ConfigurationError where it is none, or names no zone."""
    try:
        time = datetime.datetime.fromisoformat(text)
    except ValueError:
        time = None
    if time is None or time.tzinfo is None:
        raise ConfigurationError(f"--since {text!r} is no time; give one with its zone, such as 2026-05-01T10:35:56Z")
    return time


def give_mask(name: str, scene: str, request: Path, cluster: Cluster = CLUSTER) -> None:
    """Take the mask request of a scene that waits for one, and let that scene go on."""
    _give(name, scene, MASK_REQUEST, request, cluster)


def give_painting(name: str, scene: str, folder: Path, cluster: Cluster = CLUSTER) -> None:
    """Take the painted views of a scene that waits for them, and let that scene go on."""
    _give(name, scene, PAINTED, folder, cluster)


def _give(name: str, scene: str, external: str, path: Path, cluster: Path) -> None:
    where = _cluster(cluster)
    workflow = clusters.give(open_store(where.spec.store), where, name, scene, external, path)
    sys.stdout.write(f"{workflow}: {scene} goes on\n")
