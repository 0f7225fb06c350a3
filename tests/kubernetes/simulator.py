"""A small Argo: executes emitted YAML with processes for pods, so that what the manifests say is what is tested.

DAG order, parameters, fan-out, files from raw artifacts, retries by their expression, suspension, the exit handler;
images that cannot be pulled, for which a pod waits until its deadline;
the nodes of a Workflow's status as a real controller writes them, compressed where there are many; and what a namespace
with `restricted` pod security, a quota and role-based access refuses.
"""

import base64
import datetime
import graphlib
import gzip
import json
import os
import re
import subprocess
import sys
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from inpaint3d.contracts.kit.process import LAST_WORDS
from inpaint3d.orchestrator.emit.policy import find_unrestricted
from inpaint3d.orchestrator.workflows import nodes_of

Document = dict[str, Any]
Values = dict[str, str]
FAILED = ("Failed", "Error")
PAST_DEADLINE = "Pod was active on the node longer than the specified deadline"
"""What Kubernetes says of a pod that its `activeDeadlineSeconds` ended, also while it waited for its image."""


@dataclass
class Pod:
    """One try of one container."""

    where: str
    phase: str
    code: str
    log: str
    message: str = ""


@dataclass
class Argo:
    """Runs a Workflow of a WorkflowTemplate below a folder."""

    documents: list[Document]
    """What was applied: the account and its role, the WorkflowTemplate."""
    folder: Path
    image_environment: Callable[[str], dict[str, str]]
    """Image reference -> the environment that the image itself sets."""
    supply: "Callable[[Argo, str], None]" = lambda argo, where: None
    """What a person does where the Workflow waits at a node: patches it."""
    loses: Callable[[str, int], bool] = lambda where, attempt: False
    """Whether the node under a pod is lost at this attempt."""
    lacks: Callable[[str], bool] = lambda image: False
    """Whether an image cannot be pulled."""
    look: "Callable[[Argo], None]" = lambda argo: None
    """What somebody does while a pod waits for its image."""
    compress_from: int = 400
    """Of how many nodes on the controller keeps them compressed."""
    pods: list[Pod] = field(default_factory=list)

    def run(self, workflow: Document) -> str:
        """Execute; returns the phase that the Workflow ends in."""
        self.workflow = {**workflow, "status": {"phase": "Running", "nodes": {}}}
        self.workflow["metadata"] = {**workflow["metadata"], "resourceVersion": "1"}
        (template,) = [d for d in self.documents if d["kind"] == "WorkflowTemplate"]
        self._spec = spec = template["spec"]
        self._templates = {t["name"]: t for t in spec["templates"]}
        given = {p["name"]: p["value"] for p in workflow["spec"]["arguments"]["parameters"]}
        scope = {f"workflow.parameters.{n}": v for n, v in given.items()}
        name = scope["workflow.name"] = workflow["metadata"]["name"]
        scope["workflow.creationTimestamp"] = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        try:
            self._run(spec["entrypoint"], {}, scope, name, "")
            phase = "Succeeded"
        except StageFailedError:
            phase = "Failed"
        self.workflow["status"]["phase"] = phase
        self._run(spec["onExit"], {}, scope | {"workflow.status": phase}, name + ".onExit", "")
        return phase

    def nodes(self) -> dict[str, Document]:
        """The nodes of the status, by id."""
        return nodes_of(self.workflow)

    def patch(self, change: Document) -> None:
        """Apply a merge patch, as the API server does."""
        if change["metadata"]["resourceVersion"] != self.workflow["metadata"]["resourceVersion"]:
            raise ConflictError(change["metadata"]["resourceVersion"])
        version = str(int(self.workflow["metadata"]["resourceVersion"]) + 1)
        self.workflow = merge(self.workflow, {**change, "metadata": {"resourceVersion": version}})

    def _set_node(self, where: str, **values: Any) -> str:
        """Change a node, made where there is none; its id."""
        nodes = dict(self.nodes())
        key = f"{self.workflow['metadata']['name']}-{zlib.crc32(where.encode())}"
        nodes[key] = {**nodes.get(key, {"id": key, "name": where, "startedAt": now()}), **values}
        if values.get("phase") in (*FAILED, "Succeeded"):
            nodes[key].setdefault("finishedAt", now())
        status: Document = {"phase": self.workflow["status"]["phase"]}
        if len(nodes) < self.compress_from:
            status["nodes"] = nodes
        else:
            status["compressedNodes"] = base64.b64encode(gzip.compress(json.dumps(nodes).encode())).decode()
        version = str(int(self.workflow["metadata"]["resourceVersion"]) + 1)
        metadata = {**self.workflow["metadata"], "resourceVersion": version}
        self.workflow = {**self.workflow, "metadata": metadata, "status": status}
        return key

    def _run(self, name: str, arguments: Values, scope: Values, where: str, boundary: str) -> Values:
        template = self._templates[name]
        wanted = {p["name"] for p in template.get("inputs", {}).get("parameters", [])}
        assert wanted == set(arguments), f"{where}: wants {wanted}, got {set(arguments)}"
        scope = {k: v for k, v in scope.items() if k.startswith("workflow.")}
        scope |= {f"inputs.parameters.{n}": v for n, v in arguments.items()}
        kind = "DAG" if "dag" in template else "Suspend" if "suspend" in template else "Retry"
        inputs = {"parameters": [{"name": n, "value": v} for n, v in arguments.items()]}
        key = self._set_node(
            where, type=kind, templateName=name, boundaryID=boundary, inputs=inputs, phase="Running",
            displayName=re.sub(r"\(.*", "", where[len(self.nodes().get(boundary, {}).get("name", "")) :]).strip("."),
        )  # fmt: skip
        try:
            if kind == "DAG":
                outputs = self._dag(template, scope, where, key)
            elif kind == "Suspend":
                outputs = self._suspend(template, where, key)
            else:
                outputs = self._pod(substitute(template, scope), where, boundary)
        except StageFailedError:
            self._set_node(where, phase="Failed")
            raise
        self._set_node(where, phase="Succeeded")
        return outputs

    def _suspend(self, template: Document, where: str, key: str) -> Values:
        wanted = [{"name": p["name"], "valueFrom": p["valueFrom"]} for p in template["outputs"]["parameters"]]
        self._set_node(where, outputs={"parameters": wanted})
        self.supply(self, where)
        node = self.nodes()[key]
        assert node["phase"] == "Succeeded", f"{where}: nobody let it go on"
        return {p["name"]: p["value"] for p in node["outputs"]["parameters"]}

    def _dag(self, template: Document, scope: Values, where: str, key: str) -> Values:
        tasks = {t["name"]: t for t in template["dag"]["tasks"]}
        order = graphlib.TopologicalSorter({n: t.get("dependencies", []) for n, t in tasks.items()}).static_order()
        failed: set[str] = set()
        for name in order:
            task = tasks[name]
            if failed & set(task.get("dependencies", [])):
                failed.add(name)
                continue
            # Argo resolves a task's arguments from what it waits for, and nothing else.
            items: list[Any] = [None]
            if "withParam" in task:
                items = json.loads(substitute(task["withParam"], scope))
            for i, item in enumerate(items):
                inner = scope | ({} if item is None else {f"item.{k}": v for k, v in item.items()})
                arguments = {
                    p["name"]: substitute(p["value"], inner) for p in task.get("arguments", {}).get("parameters", [])
                }
                # The whole item stands in the name, whatever is in it.
                said = "" if item is None else ",".join(f"{k}:{v}" for k, v in sorted(item.items()))
                place = f"{where}.{name}" + ("" if item is None else f"({i}:{said})")
                try:
                    outputs = self._run(task["template"], arguments, scope, place, key)
                except StageFailedError:
                    failed.add(name)
                    continue
                scope |= {f"tasks.{name}.outputs.parameters.{k}": v for k, v in outputs.items()}
        if failed:
            raise StageFailedError(where)
        return {}

    def _pod(self, template: Document, where: str, boundary: str) -> Values:
        strategy = template["retryStrategy"]
        for attempt in range(int(strategy["limit"]) + 1):
            root = self.folder / f"{zlib.crc32(where.encode())}" / str(attempt)
            place, node = (
                f"{where}({attempt})",
                {"type": "Pod", "templateName": template["name"], "boundaryID": boundary},
            )
            if refused := self._refuse(template):
                pod = Pod(where, "Error", "-1", "", refused)
            elif self.lacks(image := template["container"]["image"]):
                back_off = f'ImagePullBackOff: Back-off pulling image "{image}"'
                self._set_node(place, **node, phase="Pending", message=back_off)
                self.look(self)
                assert "activeDeadlineSeconds" in template, f"{where}: it would wait for ever"
                pod = Pod(where, "Failed", "-1", "", PAST_DEADLINE)
            else:
                pod = self._try(template, where, root, attempt)
            self.pods.append(pod)
            self._set_node(place, **node, phase=pod.phase, message=pod.message)
            if pod.phase == "Succeeded":
                outputs = template.get("outputs", {}).get("parameters", [])
                return {p["name"]: _inside(root, p["valueFrom"]["path"]).read_text() for p in outputs}
            if not evaluate(strategy["expression"], pod):
                break
        raise StageFailedError(where)

    def _refuse(self, template: Document) -> str:
        """Why the namespace lets no such pod in, or the pod cannot tell how it ended; else nothing."""
        patch = json.loads(self._spec.get("podSpecPatch", "{}"))
        argos = {"init": patch.get("initContainers", []), "wait": patch.get("containers", [])}
        pod = {name: next((c for c in found if c["name"] == name), {}) for name, found in argos.items()}
        pod["main"] = template["container"]
        problems = [p for name, container in pod.items() for p in find_unrestricted(name, container)]
        account = self._spec.get("serviceAccountName", "default")
        role = next((d for d in self.documents if d["kind"] == "Role" and d["metadata"]["name"] == account), {})
        allowed = {(r, v) for rule in role.get("rules", []) for r in rule["resources"] for v in rule["verbs"]}
        if not {("workflowtaskresults", "create"), ("workflowtaskresults", "patch")} <= allowed:
            problems.append(f"{account} may not report to Argo")
        return "; ".join(problems)

    def _try(self, template: Document, where: str, root: Path, attempt: int) -> Pod:
        container = template["container"]
        for mount in container["volumeMounts"]:
            _inside(root, mount["mountPath"]).mkdir(parents=True)
        for artifact in template.get("inputs", {}).get("artifacts", []):
            path = _inside(root, artifact["path"])
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(artifact["raw"]["data"])
            path.chmod(artifact["mode"])
        mounts = [m["mountPath"] for m in container["volumeMounts"]] + ["/inpaint3d"]

        def here(text: str) -> str:
            inside = any(text == m or text.startswith(m + "/") for m in mounts)
            return str(_inside(root, text)) if inside else text

        environment = {e["name"]: here(e["value"]) for e in container["env"]}
        words = environment[LAST_WORDS] = str(root / "termination-log")
        line = [str(Path(sys.executable).parent / container["command"][0]), *container["command"][1:]]
        process = subprocess.Popen(
            line + [here(a) for a in container["args"]],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=self.folder,
            env={**os.environ, **self.image_environment(container["image"]), **environment},
        )  # fmt: skip
        if self.loses(where, attempt):
            process.kill()
            return Pod(where, "Error", "-1", process.communicate()[0], "pod deleted")
        log, _ = process.communicate()
        if process.returncode == 0:
            return Pod(where, "Succeeded", "0", log)
        said = Path(words).read_text() if Path(words).is_file() else ""
        message = f"Error (exit code {process.returncode})" + (f": {said}" if said else "")
        return Pod(where, "Failed", str(process.returncode), log, message)


class StageFailedError(Exception):
    """A pod failed for good."""


class ConflictError(Exception):
    """A patch is of another version of the object."""


def now() -> str:
    return datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def merge(value: Any, change: Any) -> Any:
    """A JSON merge patch (RFC 7396)."""
    if not isinstance(change, dict):
        return change
    old = value if isinstance(value, dict) else {}
    merged = {**old, **{k: merge(old.get(k), v) for k, v in change.items()}}
    return {k: v for k, v in merged.items() if v is not None}


def substitute(value: Any, scope: Values) -> Any:
    """Placeholders in strings, however deep; as in Argo, one that is unknown is an error."""
    if isinstance(value, dict):
        return {k: substitute(v, scope) for k, v in value.items()}
    if isinstance(value, list):
        return [substitute(v, scope) for v in value]
    if isinstance(value, str):
        return re.sub(r"\{\{(.+?)\}\}", lambda m: scope[m.group(1)], value)
    return value


def evaluate(expression: str, pod: Pod) -> bool:
    """The part of Argo's expression language that a retry strategy uses."""
    python = expression.replace("||", " or ").replace("&&", " and ").replace("!(", " not (")
    python = re.sub(r"(\S+) contains (\"[^\"]*\")", r"(\2 in \1)", python)
    last = SimpleNamespace(exitCode=pod.code, status=pod.phase, message=pod.message)
    return bool(eval(python, {"asInt": int, "lastRetry": last}))  # noqa: S307 - the project's own manifest


def _inside(root: Path, path: str) -> Path:
    return root / path.removeprefix("/")
