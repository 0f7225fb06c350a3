"""Scenes on a cluster: what is asked of it, what became of it, and `kubectl`, which knows how to reach it."""

import datetime
import json
import secrets
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.cluster import ClusterSpec, Scene, Submission
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import NodeRun, RunRecord
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.configure import ConfiguredPipeline, configure_submission
from inpaint3d.orchestrator.emit.argo import LABEL, Document, dump, emit
from inpaint3d.orchestrator.emit.check import check
from inpaint3d.orchestrator.history import History, this_machine
from inpaint3d.orchestrator.intake import MASK_REQUEST, PAINTED, take_mask_request
from inpaint3d.orchestrator.painting import take_painted
from inpaint3d.orchestrator.plan import Planner, Selection, preview

SUPPLIED = {MASK_REQUEST: "masks", PAINTED: "paintings"}
"""External that a scene may wait for -> where the store remembers what was supplied."""


def prepare(
    store: Store, pipeline: Pipeline, cluster: ClusterSpec, submission: Submission, *, suffix: str = ""
) -> list[Document]:
    """What to give the cluster, checked as far as that goes without one. The store remembers what is asked for."""
    documents = emit(pipeline, cluster, submission, suffix=suffix)
    if findings := check(documents, pipeline):
        raise ConfigurationError("the manifests are wrong:\n" + "\n".join(findings))
    if not suffix:
        store.write(_place(submission.name), submission.model_dump_json().encode())
    return documents


def submit(cluster: ClusterSpec, documents: list[Document]) -> list[str]:
    """Start what was prepared. Returns the names of its Workflows."""
    template, *workflows = documents
    kubectl(cluster, "apply", "-f", "-", stdin=dump([template]))
    kubectl(cluster, "create", "-f", "-", stdin=dump(workflows))
    return [w["metadata"]["name"] for w in workflows]


def rerun(store: Store, pipeline: Pipeline, cluster: ClusterSpec, name: str, node: str, scenes: list[str]) -> list[str]:
    """Compute a node of a submission again, and what then changes behind it. All its scenes, or those named."""
    submission = load_submission(store, name)
    configured = configure_submission(pipeline, submission)
    if node not in configured.pipeline.nodes:
        why = configured.left_out.get(node, f"there are {', '.join(configured.pipeline.order)}")
        raise ConfigurationError(f"{name} has no stage {node}; {why}")
    known = {s.name: s for s in submission.scenes}
    if unknown := sorted(set(scenes) - set(known)):
        raise ConfigurationError(f"{name} has no scene {', '.join(unknown)}; it has {', '.join(known)}")
    picked = tuple(s for s in known.values() if not scenes or s.name in scenes)
    there = {external for external in SUPPLIED if all(external in s.externals for s in picked)}
    waits = {
        "awaitMasks": submission.awaitMasks and MASK_REQUEST not in there,
        "awaitPaintings": submission.awaitPaintings and PAINTED not in there,
    }
    chosen = submission.model_copy(update={"scenes": picked, **waits})
    for scene in chosen.scenes:
        row = next(r for r in _rows(store, configured, chosen, scene) if r.node == node)
        if row.key is not None:
            store.forget(row.key)
    return submit(cluster, prepare(store, pipeline, cluster, chosen, suffix=f"-{secrets.token_hex(3)}"))


def load_submission(store: Store, name: str) -> Submission:
    """What was asked for under a name, with the masks supplied since; ConfigurationError where nothing was."""
    if (data := store.read(_place(name))) is None:
        names = ", ".join(n.removesuffix(".json") for n in store.names("submissions")) or "none yet"
        raise ConfigurationError(f"nothing was submitted as {name}; there are {names}")
    submission = Submission.model_validate_json(data)
    scenes: list[Scene] = []
    for scene in submission.scenes:
        found = {e: store.read(f"{folder}/{name}/{scene.name}") for e, folder in SUPPLIED.items()}
        supplied = {e: data.decode() for e, data in found.items() if data is not None}
        scenes.append(scene.model_copy(update={"externals": {**scene.externals, **supplied}}))
    return submission.model_copy(update={"scenes": tuple(scenes)})


def supply(store: Store, name: str, scene: str, external: str, path: Path) -> Digest:
    """Take what a scene waits for into the store, and remember it for the scene's record."""
    if scene not in (known := [s.name for s in load_submission(store, name).scenes]):
        raise ConfigurationError(f"{name} has no scene {scene}; it has {', '.join(known)}")
    digest = take_mask_request(store, path) if external == MASK_REQUEST else take_painted(store, path)
    store.write(f"{SUPPLIED[external]}/{name}/{scene}", digest.encode())
    return digest


def _place(name: str) -> str:
    return f"submissions/{name}.json"


def record(store: Store, pipeline: Pipeline, submission: Submission) -> list[RunRecord]:
    """Write a record of each scene's run, from what the store has under the keys that the scene has now."""
    now = datetime.datetime.now(datetime.UTC)
    records: list[RunRecord] = []
    configured = configure_submission(pipeline, submission)
    for scene in submission.scenes:
        rows = _rows(store, configured, submission, scene)
        run = RunRecord(
            id=History(store).new_id(scene.name),
            name=scene.name,
            pipeline=str(pipeline.path),
            preset=submission.preset,
            externals=scene.externals,
            status="done" if all(r.status in ("cached", "left-out") for r in rows) else "failed",
            started=now.isoformat(),
            finished=now.isoformat(),
            machine=this_machine(),
            nodes=tuple(rows),
        )
        History(store).save(run)
        records.append(run)
    return records


def _rows(store: Store, configured: ConfiguredPipeline, submission: Submission, scene: Scene) -> list[NodeRun]:
    planner = Planner(
        configured=configured,
        store=store,
        history=History(store),
        name=scene.name,
        externals=scene.externals,
        device=submission.device,
        stub=submission.stub,
        images=submission.images,
    )
    return preview(planner, Selection())


def status(cluster: ClusterSpec, name: str) -> Iterator[tuple[str, str, str]]:
    """Where each pod and each wait of a submission stands: (place, phase, message)."""
    found = kubectl(cluster, "get", "workflows.argoproj.io", "-l", f"{LABEL}/submission={name}", "-o", "json")
    items: list[Document] = json.loads(found)["items"]
    if not items:
        raise ConfigurationError(f"the cluster has no Workflow of {name}; `inpaint3d submit` starts one")
    for workflow in items:
        said: Document = workflow.get("status", {})
        yield workflow["metadata"]["name"], said.get("phase", "Pending"), said.get("message", "")
        nodes: dict[str, Document] = said.get("nodes", {})
        for node in sorted(nodes.values(), key=lambda n: str(n["name"])):
            if node["type"] in ("Pod", "Suspend"):
                yield node["name"], node.get("phase", "Pending"), node.get("message", "")


def logs(cluster: ClusterSpec, name: str, node: str | None) -> str:
    """What the pods of a submission printed, or those of one node."""
    selector = f"{LABEL}/template={name}" + (f",{LABEL}/node={node}" if node else "")
    return kubectl(
        cluster, "logs", "-l", selector, "-c", "main", "--prefix", "--tail=-1", "--max-log-requests=100"
    )  # fmt: skip


def kubectl(cluster: ClusterSpec, *arguments: str, stdin: str | None = None) -> str:
    """What kubectl answers. It finds the cluster as it always does: KUBECONFIG and its current context."""
    if shutil.which("kubectl") is None:
        raise ConfigurationError("kubectl is not on the PATH; install it, and point KUBECONFIG at the cluster")
    line: list[Any] = ["kubectl", "--namespace", cluster.spec.namespace, *arguments]
    result = subprocess.run(line, input=stdin, capture_output=True, text=True, check=False)
    if result.returncode != 0:
        raise ConfigurationError(
            f"kubectl {' '.join(arguments)}: {(result.stderr.splitlines() or [''])[-1]} (KUBECONFIG says where)"
        )
    return result.stdout
