"""A small Argo: executes emitted YAML with processes for pods, so that what the manifests say is what is tested.

DAG order, parameters, fan-out, files from raw artifacts, retries by their expression, suspension, the exit handler.
"""

import graphlib
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

Document = dict[str, Any]
Values = dict[str, str]
FAILED = ("Failed", "Error")


@dataclass
class Pod:
    """One try of one container."""

    where: str
    phase: str
    code: str
    log: str


@dataclass
class Argo:
    """Runs a Workflow of a WorkflowTemplate below a folder."""

    template: Document
    folder: Path
    image_environment: Callable[[str], dict[str, str]]
    """Image reference -> the environment that the image itself sets."""
    supply: Callable[[str], Values] = lambda where: {}
    """What a person supplies where the Workflow waits."""
    loses: Callable[[str, int], bool] = lambda where, attempt: False
    """Whether the node under a pod is lost at this attempt."""
    pods: list[Pod] = field(default_factory=list)

    def run(self, workflow: Document) -> str:
        """Execute; returns the phase that the Workflow ends in."""
        spec = self.template["spec"]
        self._templates = {t["name"]: t for t in spec["templates"]}
        self._retries = 0
        given = {p["name"]: p["value"] for p in workflow["spec"]["arguments"]["parameters"]}
        scope = {f"workflow.parameters.{n}": v for n, v in given.items()}
        scope["workflow.name"] = workflow["metadata"]["name"]
        try:
            self._run(spec["entrypoint"], {}, scope, workflow["metadata"]["name"])
            phase = "Succeeded"
        except StageFailedError:
            phase = "Failed"
        self._run(spec["onExit"], {}, scope | {"workflow.status": phase}, workflow["metadata"]["name"] + ".onExit")
        return phase

    def _run(self, name: str, arguments: Values, scope: Values, where: str) -> Values:
        template = self._templates[name]
        wanted = {p["name"] for p in template.get("inputs", {}).get("parameters", [])}
        assert wanted == set(arguments), f"{where}: wants {wanted}, got {set(arguments)}"
        scope = {k: v for k, v in scope.items() if k.startswith("workflow.")}
        scope |= {f"inputs.parameters.{n}": v for n, v in arguments.items()}
        if "dag" in template:
            return self._dag(template, scope, where)
        if "suspend" in template:
            supplied = self.supply(where)
            return {p["name"]: supplied[p["name"]] for p in template["outputs"]["parameters"]}
        return self._pod(substitute(template, scope), where)

    def _dag(self, template: Document, scope: Values, where: str) -> Values:
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
                place = f"{where}.{name}" + ("" if item is None else f"({i}:{item['name']})")
                try:
                    outputs = self._run(task["template"], arguments, scope, place)
                except StageFailedError:
                    failed.add(name)
                    continue
                scope |= {f"tasks.{name}.outputs.parameters.{k}": v for k, v in outputs.items()}
        if failed:
            raise StageFailedError(where)
        return {}

    def _pod(self, template: Document, where: str) -> Values:
        strategy = template["retryStrategy"]
        for attempt in range(int(strategy["limit"]) + 1):
            root = self.folder / re.sub(r"[^a-z0-9-]+", "_", where) / str(attempt)
            pod = self._try(template, where, root, attempt)
            self.pods.append(pod)
            if pod.phase == "Succeeded":
                outputs = template.get("outputs", {}).get("parameters", [])
                return {p["name"]: _inside(root, p["valueFrom"]["path"]).read_text() for p in outputs}
            if not evaluate(strategy["expression"], pod):
                break
        raise StageFailedError(where)

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
        line = [str(Path(sys.executable).parent / container["command"][0]), *container["command"][1:]]
        process = subprocess.Popen(
            line + [here(a) for a in container["args"]],
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=self.folder,
            env={**os.environ, **self.image_environment(container["image"]), **environment},
        )  # fmt: skip
        if self.loses(where, attempt):
            process.kill()
            return Pod(where, "Error", "-1", process.communicate()[0])
        log, _ = process.communicate()
        return Pod(where, "Succeeded" if process.returncode == 0 else "Failed", str(process.returncode), log)


class StageFailedError(Exception):
    """A pod failed for good."""


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
    last = SimpleNamespace(exitCode=pod.code, status=pod.phase, message="")
    return bool(eval(python, {"asInt": int, "lastRetry": last}))  # noqa: S307 - the project's own manifest


def _inside(root: Path, path: str) -> Path:
    return root / path.removeprefix("/")
