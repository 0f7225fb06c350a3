"""The commands that have to do with a cluster."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console
from rich.table import Table

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.cluster import ClusterSpec, ImagesSpec, Scene, Submission
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import open_store
from inpaint3d.orchestrator import cluster as clusters
from inpaint3d.orchestrator.emit.argo import dump
from inpaint3d.orchestrator.emit.check import check
from inpaint3d.orchestrator.intake import MASK_REQUEST, PAINTED, list_scenes, name_run
from inpaint3d.orchestrator.options import (
    IMAGES,
    STORE,
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


def add_to(app: typer.Typer) -> None:
    """Make the commands part of `inpaint3d`."""
    for command in (submit, status, logs, rerun, record):
        app.command()(command)
    app.command(name="take-mask")(take_mask)
    app.command(name="take-painting")(take_painting)


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
    cluster: Cluster = CLUSTER,
    images: Images = IMAGES,
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
        images=load_document(images, ImagesSpec)[0].spec,
        scenes=tuple(Scene(name=n, externals=configured.take_externals(store, p)) for p, n in scenes),
    )
    sys.stdout.write(dump(clusters.prepare(store, configured.whole, where, submission)))


@emit_app.command(name="check")
def check_file(manifest: Path, pipeline: PipelinePath = None) -> None:
    """Say what is wrong with manifests, as far as that can be known without a cluster."""
    _conclude(check(_documents(manifest), Pipeline(find_pipeline(pipeline))))


def _documents(manifest: Path) -> list[Any]:
    try:
        return list(yaml.safe_load_all(manifest.read_text()))
    except (OSError, yaml.YAMLError) as error:
        raise ConfigurationError(f"cannot read {manifest}: {error}; give what `inpaint3d emit argo` wrote") from error


def _conclude(findings: list[str]) -> None:
    for finding in findings:
        sys.stdout.write(finding + "\n")
    if findings:
        raise ConfigurationError(f"{len(findings)} things are wrong with these manifests; emit them again")


def submit(manifest: Path, cluster: Cluster = CLUSTER, pipeline: PipelinePath = None) -> None:
    """Give what `emit argo` wrote to the cluster that kubectl is pointed at; what the store has is not run again."""
    documents = _documents(manifest)
    _conclude(check(documents, Pipeline(find_pipeline(pipeline))))
    for workflow in clusters.submit(_cluster(cluster), documents):
        sys.stdout.write(workflow + "\n")


def status(name: str, cluster: Cluster = CLUSTER) -> None:
    """Say where every pod of a submission stands."""
    table = Table("where", "phase", "message", box=None)
    for row in clusters.status(_cluster(cluster), name):
        table.add_row(*row)
    Console().print(table)


def logs(
    name: str,
    stage: Annotated[str | None, typer.Option(help="of this stage alone")] = None,
    cluster: Cluster = CLUSTER,
) -> None:
    """Print what the pods of a submission said."""
    sys.stdout.write(clusters.logs(_cluster(cluster), name, stage))


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
    for workflow in clusters.rerun(store, checked, where, name, stage, scene or []):
        sys.stdout.write(workflow + "\n")


def record(
    name: str,
    scenes: Annotated[str | None, typer.Option(help="of these alone: a Workflow's JSON list of scenes")] = None,
    store: StorePath = STORE,
    pipeline: PipelinePath = None,
) -> None:
    """Write the record of every scene of a submission to the store: the exit handler of a Workflow."""
    opened = open_store(store)
    submission = clusters.load_submission(opened, name)
    if scenes is not None:
        names = {scene["name"] for scene in json.loads(scenes)}
        submission = submission.model_copy(update={"scenes": tuple(s for s in submission.scenes if s.name in names)})
    for run in clusters.record(opened, Pipeline(find_pipeline(pipeline)), submission):
        sys.stdout.write(f"{run.name}: {run.status}\n")


def take_mask(name: str, scene: str, request: Path, store: StorePath = STORE) -> None:
    """Take the mask request of a scene that waits for one; prints the digest that its Workflow is resumed with."""
    sys.stdout.write(clusters.supply(open_store(store), name, scene, MASK_REQUEST, request) + "\n")


def take_painting(name: str, scene: str, folder: Path, store: StorePath = STORE) -> None:
    """Take the painted views of a scene that waits for them; prints the digest that its Workflow is resumed with."""
    sys.stdout.write(clusters.supply(open_store(store), name, scene, PAINTED, folder) + "\n")
