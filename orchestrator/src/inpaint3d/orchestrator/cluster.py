"""Scenes on a cluster: what is asked of it, what became of it, and `kubectl`, which knows how to reach it."""

import datetime
import json
import secrets
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError, RetryableError
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.models.cluster import ClusterSpec, Scene, Submission
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import NodeRun, RunRecord
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.configure import ConfiguredPipeline, configure_submission
from inpaint3d.orchestrator.emit.argo import ASKED, LABEL, emit
from inpaint3d.orchestrator.emit.check import check
from inpaint3d.orchestrator.emit.documents import Document, dump
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import MASK_REQUEST, PAINTED, take_mask_request
from inpaint3d.orchestrator.painting import take_painted
from inpaint3d.orchestrator.plan import Planner, Selection, preview
from inpaint3d.orchestrator.workflows import supply_patch

WORKFLOWS, MAIN = "workflows.argoproj.io", "main"
TRIES = 5

SUPPLIED = {MASK_REQUEST: "masks", PAINTED: "paintings"}
"""External that a scene may wait for -> where the store remembers what was supplied."""


def prepare(
    store: Store,
    pipeline: Pipeline,
    cluster: ClusterSpec,
    submission: Submission,
    *,
    suffix: str = "",
    replace: bool = False,
) -> list[Document]:
    """What to give the cluster, checked as far as that goes without one. The store remembers what is asked for.

    ConfigurationError where something else was asked for under the name, which is not to be replaced: the record of
    what already runs is written from it.
    """
    documents = emit(pipeline, cluster, submission, suffix=suffix)
    if findings := check(documents, pipeline):
        raise ConfigurationError("the manifests are wrong:\n" + "\n".join(findings))
    if not suffix:
        data, place = submission.model_dump_json().encode(), _place(submission.name)
        if not replace and store.read(place) not in (None, data):
            raise ConfigurationError(
                f"--name {submission.name}: something else was emitted under it before; give another --name, or "
                "--replace where none of its Workflows still runs"
            )
        store.write(place, data)
    return documents


def submit(cluster: ClusterSpec, documents: list[Document]) -> dict[str, str]:
    """Start what was prepared, as far as the cluster has it not yet. Workflow -> `started`, or its phase before.

    ConfigurationError where the cluster has another Workflow of a name.
    """
    workflows = [d for d in documents if d["kind"] == "Workflow"]
    there = {w["metadata"]["name"]: w for w in _list_named(cluster, [w["metadata"]["name"] for w in workflows])}
    for workflow in workflows:
        known = there.get(workflow["metadata"]["name"])
        if known is not None and _find_request(known) != _find_request(workflow):
            raise ConfigurationError(
                f"the cluster has another Workflow {workflow['metadata']['name']}; emit under another --name, "
                f"or `kubectl --namespace {cluster.spec.namespace} delete workflow {workflow['metadata']['name']}`"
            )
    if new := [w for w in workflows if w["metadata"]["name"] not in there]:
        kubectl(cluster, "apply", "-f", "-", stdin=dump([d for d in documents if d["kind"] != "Workflow"]))
        kubectl(cluster, "create", "-f", "-", stdin=dump(new))
    return {w["metadata"]["name"]: _say_phase(there.get(w["metadata"]["name"])) for w in workflows}


def _find_request(workflow: Document) -> str | None:
    annotations: dict[str, str] = workflow["metadata"].get("annotations") or {}
    return annotations.get(ASKED)


def _say_phase(known: Document | None) -> str:
    return "started" if known is None else f"there already ({phase_of(known)})"


def phase_of(workflow: Document) -> str:
    """Argo's word for where a Workflow stands."""
    status: Document = workflow.get("status") or {}
    return str(status.get("phase") or "Pending")


def _list_named(cluster: ClusterSpec, names: list[str]) -> list[Document]:
    """Those of these Workflows that the cluster has."""
    if not names:
        return []
    found = kubectl(cluster, "get", WORKFLOWS, "--ignore-not-found", "-o", "json", *names)
    if not found.strip():
        return []
    answer: Document = json.loads(found)
    return answer.get("items", [answer])  # of one name it is that one, no list


def rerun(
    store: Store, pipeline: Pipeline, cluster: ClusterSpec, name: str, node: str, scenes: list[str]
) -> dict[str, str]:
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
        row = next(r for r in _list_rows(store, configured, chosen, scene) if r.node == node)
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


def give(store: Store, cluster: ClusterSpec, name: str, scene: str, external: str, path: Path) -> str:
    """Take what a scene waits for into the store and let its Workflow, and no other scene of it, go on.

    Returns the Workflow's name. ConfigurationError where nothing of the scene waits; RetryableError where the Workflow
    changed each time that it was to be told.
    """
    digest = supply(store, name, scene, external, path)
    for _ in range(TRIES):
        for workflow in list_workflows(cluster, name):
            patch = supply_patch(workflow, scene, external, digest, datetime.datetime.now(datetime.UTC))
            if patch is None:
                continue
            found = workflow["metadata"]["name"]
            try:
                kubectl(cluster, "patch", WORKFLOWS, found, "--type", "merge", "-p", json.dumps(patch))
            except ConfigurationError as error:
                if "modified" not in str(error) and "Conflict" not in str(error):
                    raise
                break  # the controller was faster: read it again
            return found
        else:
            raise ConfigurationError(
                f"nothing of {scene} waits for its {external}; `inpaint3d status {name}` says where it is"
            )
    raise RetryableError(f"the Workflow of {scene} changed {TRIES} times while it was to be told; try again")


def _place(name: str) -> str:
    return f"submissions/{name}.json"


def record(
    store: Store, pipeline: Pipeline, submission: Submission, since: datetime.datetime | None = None
) -> list[RunRecord]:
    """Write a record of each scene's run, from what the store has under the keys that the scene has now.

    since: when the scenes' Workflow was made; None where nobody knows, and the records then have no duration.
    """
    now = datetime.datetime.now(datetime.UTC)
    wall_s = None if since is None else round(max(0.0, (now - since).total_seconds()), 3)
    records: list[RunRecord] = []
    configured = configure_submission(pipeline, submission)
    for scene in submission.scenes:
        rows = _list_rows(store, configured, submission, scene)
        run = RunRecord(
            id=History(store).new_id(scene.name),
            name=scene.name,
            pipeline=str(pipeline.path),
            preset=submission.preset,
            externals=scene.externals,
            status="done" if all(r.status in ("cached", "left-out") for r in rows) else "failed",
            started=(since or now).isoformat(),
            finished=now.isoformat(),
            wall_s=wall_s,
            machine=None,
            nodes=tuple(rows),
        )
        History(store).save(run)
        records.append(run)
    return records


def _list_rows(store: Store, configured: ConfiguredPipeline, submission: Submission, scene: Scene) -> list[NodeRun]:
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


def list_workflows(cluster: ClusterSpec, name: str) -> list[Document]:
    """The Workflows of a submission; ConfigurationError where the cluster has none."""
    found = kubectl(cluster, "get", WORKFLOWS, "-l", f"{LABEL}/submission={name}", "-o", "json")
    items: list[Document] = json.loads(found)["items"]
    if not items:
        raise ConfigurationError(f"the cluster has no Workflow of {name}; `inpaint3d submit` starts one")
    return items


def logs(cluster: ClusterSpec, name: str, node: str | None) -> Iterator[str]:
    """What the pods of a submission printed, or those of one node; of a pod that has not begun, that it has not."""
    selector = f"{LABEL}/template={name}" + (f",{LABEL}/node={node}" if node else "")
    pods: list[Document] = json.loads(kubectl(cluster, "get", "pods", "-l", selector, "-o", "json"))["items"]
    for pod in pods:
        title = pod["metadata"]["name"]
        if (reason := _explain_silence(pod)) is not None:
            yield f"[{title}] has printed nothing yet: {reason}\n"
            continue
        try:
            said = kubectl(cluster, "logs", title, "-c", MAIN)
        except ConfigurationError as error:  # it was removed, or its node is gone: the others still have theirs
            said = f"has no log: {error}"
        for line in said.splitlines():
            yield f"[{title}] {line}\n"


def _explain_silence(pod: Document) -> str | None:
    """Why a pod has no log yet, or None."""
    status: Document = pod.get("status") or {}
    statuses: list[Document] = status.get("containerStatuses") or []
    for container in statuses:
        if container["name"] == MAIN:
            state: Document = container.get("state") or {}
            waiting: Document | None = state.get("waiting")
            return None if waiting is None else str(waiting.get("reason") or "it is about to start")
    return str(status.get("phase") or "Pending")


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
