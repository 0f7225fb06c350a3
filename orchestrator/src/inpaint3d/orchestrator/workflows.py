"""Workflows as the cluster has them: which pod is of which scene and stage, and what becomes of them."""

import base64
import datetime
import gzip
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import cast

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.orchestrator.emit.argo import AWAIT
from inpaint3d.orchestrator.emit.documents import Document

SCENE = "scene"
"""The template of one scene's DAG, and the parameter of it that is the scene's name."""
ENDED = ("Succeeded", "Failed", "Error", "Skipped", "Omitted")
UNPULLABLE = ("ErrImagePull", "ImagePullBackOff", "InvalidImageName", "ErrImageNeverPull")


@dataclass(frozen=True)
class Row:
    """Where one stage of one scene stands: its last pod, or a wait for a person."""

    scene: str
    stage: str
    phase: str
    seconds: float | None
    tries: int
    message: str


def nodes_of(workflow: Document) -> dict[str, Document]:
    """The nodes of a Workflow's status, by id. From some four hundred on the controller keeps them compressed."""
    status: Document = workflow.get("status") or {}
    if packed := status.get("compressedNodes"):
        return cast(dict[str, Document], json.loads(gzip.decompress(base64.b64decode(packed))))
    if "offloadNodeStatusVersion" in status:
        raise ConfigurationError(
            f"{workflow['metadata']['name']} keeps its nodes in a database, which kubectl cannot read; "
            "use the Argo server's own command, or submit fewer scenes a Workflow (scenesPerWorkflow)"
        )
    return status.get("nodes") or {}


def scene_of(node: Document, nodes: dict[str, Document]) -> str | None:
    """The scene that a node belongs to: the boundary round it that was given a scene's name."""
    here: Document | None = node
    while here is not None:
        if here.get("templateName") == SCENE and (name := _find_parameter(here, "inputs", "name")) is not None:
            return name
        here = nodes.get(here.get("boundaryID", ""))
    return None


def list_rows(workflow: Document, now: datetime.datetime) -> Iterator[Row]:
    """A row for each stage of each scene that has begun, in the order of their beginnings."""
    nodes = nodes_of(workflow)
    pods: dict[tuple[str, str], list[Document]] = {}
    for node in nodes.values():
        if node.get("type") in ("Pod", "Suspend"):
            place = (scene_of(node, nodes) or "", node.get("templateName") or node.get("displayName", ""))
            pods.setdefault(place, []).append(node)
    for (scene, stage), tries in pods.items():
        tries.sort(key=lambda n: n.get("startedAt") or "")
        last = tries[-1]
        yield Row(scene, stage, _read_phase(last), _measure_seconds(last, now), len(tries), last.get("message") or "")


def is_over(workflow: Document) -> bool:
    """Whether a Workflow has ended, well or not."""
    status: Document = workflow.get("status") or {}
    return status.get("phase") in ENDED


def supply_patch(workflow: Document, scene: str, external: str, digest: str, now: datetime.datetime) -> Document | None:
    """The merge patch that hands an external of a scene to the node that waits for it; None where no node of it waits.

    It holds for the version of the Workflow that was read; the API server refuses it for another (409).
    """
    nodes = nodes_of(workflow)
    waiting = [
        (key, node)
        for key, node in nodes.items()
        if node.get("type") == "Suspend"
        and node.get("templateName") == AWAIT[external]
        and node.get("phase") not in ENDED
        and scene_of(node, nodes) == scene
    ]
    if not waiting:
        return None
    key, node = waiting[0]
    parameters: list[Document] = [{"name": external, "value": digest, "valueFrom": {"supplied": {}}}]
    change: Document = {
        "phase": "Succeeded",
        "finishedAt": now.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "message": f"{digest} was supplied",
        "outputs": {"parameters": parameters},
    }
    status: Document = {"nodes": {key: change}}
    if "compressedNodes" in workflow["status"]:
        packed = gzip.compress(json.dumps({**nodes, key: {**node, **change}}).encode(), mtime=0)
        status = {"compressedNodes": base64.b64encode(packed).decode()}
    return {"metadata": {"resourceVersion": workflow["metadata"]["resourceVersion"]}, "status": status}


def _find_parameter(node: Document, side: str, name: str) -> str | None:
    both: Document = node.get(side) or {}
    given: list[Document] = both.get("parameters") or []
    return next((str(p.get("value")) for p in given if p["name"] == name), None)


def _read_phase(node: Document) -> str:
    """Argo's word, or that an image cannot be pulled, which Argo waits for as for any other pod."""
    phase = str(node.get("phase") or "Pending")
    unpullable = phase == "Pending" and any(word in str(node.get("message")) for word in UNPULLABLE)
    return "NoImage" if unpullable else phase


def _measure_seconds(node: Document, now: datetime.datetime) -> float | None:
    if not (started := node.get("startedAt")):
        return None
    ended = node.get("finishedAt")
    return ((datetime.datetime.fromisoformat(ended) if ended else now) - datetime.datetime.fromisoformat(started)) / (
        datetime.timedelta(seconds=1)
    )
