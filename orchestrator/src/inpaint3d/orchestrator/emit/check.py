"""What can be known of manifests without a cluster, in four layers; each finding begins with the layer that made it.

types       hera's models take the document and give it back whole; of an account and its role, that it is ours
references  every template, task and placeholder that is named is there; tasks wait for what they read, in no circle
contracts   every port of a stage is fed, schema majors agree, the invocation is the shim's, its parameters the stage's
policy      what a careful cluster refuses, and what would be regretted (`emit.policy`)
"""

import graphlib
import json
import re
from collections.abc import Iterator
from typing import Any, cast

from pydantic import ValidationError

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.models.manifest import first_error, is_compatible
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.emit.argo import LABEL, LEFT_OUT, PRESET
from inpaint3d.orchestrator.emit.documents import Document, check_types
from inpaint3d.orchestrator.emit.policy import ACCOUNT_KINDS, View, check_policy
from inpaint3d.orchestrator.parameters import resolve_parameters

PLACEHOLDER = re.compile(r"\{\{\s*([^{}]+?)\s*\}\}")
GLOBAL = {"workflow.name", "workflow.status", "workflow.namespace", "workflow.uid", "workflow.creationTimestamp"}
ANY_DIGEST = "sha256:" + "0" * 64


def check(documents: list[Document], pipeline: Pipeline) -> list[str]:
    """Everything that is wrong with a WorkflowTemplate and its Workflows: `layer: where: what`. Empty: nothing is."""
    findings = [f"types: {problem}" for d in documents if (problem := _find_type_problem(d)) is not None]
    if findings:
        return findings  # the other layers read what these have not promised
    templates = {d["metadata"]["name"]: d for d in documents if d["kind"] == "WorkflowTemplate"}
    for template in templates.values():
        view = View(template)
        findings += [f"references: {f}" for f in _check_references(view)]
        annotations = template["metadata"].get("annotations", {})
        left_out = set(json.loads(annotations.get(LEFT_OUT, "{}")))
        findings += [f"contracts: {f}" for f in _check_ports(view, pipeline.under(annotations.get(PRESET)), left_out)]
        findings += [f"policy: {f}" for f in check_policy(view, documents)]
    for workflow in (d for d in documents if d["kind"] == "Workflow"):
        findings += [f"references: {f}" for f in _check_workflow(workflow, templates)]
    return findings


def _find_type_problem(document: Document) -> str | None:
    if document.get("kind") in ACCOUNT_KINDS:
        return None  # constant but for names, which `_may_report` holds against what uses them
    try:
        check_types(document)
    except ConfigurationError as error:
        return str(error)
    return None


def _collect_names(holder: Document, side: str, kind: str = "parameters") -> set[str]:
    return {p["name"] for p in holder.get(side, {}).get(kind, [])}


def _find_placeholders(value: Any) -> set[str]:
    return set(PLACEHOLDER.findall(json.dumps(value)))


def _check_workflow(workflow: Document, templates: dict[str, Document]) -> Iterator[str]:
    at = workflow["metadata"]["name"]
    reference = workflow["spec"].get("workflowTemplateRef", {}).get("name")
    if reference not in templates:
        yield f"{at}: no WorkflowTemplate {reference}; there are {', '.join(templates)}"
        return
    spec: Document = templates[reference]["spec"]
    given = _collect_names(workflow["spec"], "arguments")
    if given != _collect_names(spec, "arguments"):
        yield f"{at}: gives {sorted(given)}, but {reference} takes {sorted(_collect_names(spec, 'arguments'))}"
    wanted = next((_collect_names(t, "inputs") for t in spec["templates"] if t["name"] == "scene"), set[str]())
    for parameter in workflow["spec"].get("arguments", {}).get("parameters", []):
        for scene in json.loads(parameter["value"]):
            if set(scene) != wanted:
                yield f"{at}: scene {scene.get('name')} has {sorted(scene)}; wanted {sorted(wanted)}"


def _check_references(view: View) -> Iterator[str]:
    for role in ("entrypoint", "onExit"):
        if view.spec.get(role) not in view.templates:
            yield f"{role}: no template {view.spec.get(role)}"
    known = {f"workflow.parameters.{n}" for n in _collect_names(view.spec, "arguments")} | GLOBAL
    for name, template in view.templates.items():
        inside = known | {f"inputs.parameters.{n}" for n in _collect_names(template, "inputs")}
        if "dag" in template:
            yield from _check_dag(view, name, template["dag"]["tasks"], inside)
        else:
            yield from (f"{name}: nothing is called {p}" for p in sorted(_find_placeholders(template) - inside))
    volumes = {v["name"] for v in view.spec.get("volumes", [])}
    for name, template in view.containers():
        for mount in template["container"].get("volumeMounts", []):
            if mount["name"] not in volumes:
                yield f"{name}: no volume {mount['name']}"


def _check_dag(view: View, at: str, tasks: list[Document], known: set[str]) -> Iterator[str]:
    graph = {t["name"]: set(cast(list[str], t.get("dependencies", []))) for t in tasks}
    if len(graph) != len(tasks):
        yield f"{at}: two tasks have one name"
    for name, after in graph.items():
        yield from (f"{at}.{name}: depends on {a}, which is no task" for a in sorted(after - set(graph)))
    try:
        order = list(graphlib.TopologicalSorter(graph).static_order())
    except graphlib.CycleError as error:
        yield f"{at}: the tasks go in a circle: {' -> '.join(error.args[1])}"
        return
    before: dict[str, set[str]] = {}
    for name in order:
        before[name] = set().union(*({a} | before.get(a, set()) for a in graph.get(name, ())))
    for task in tasks:
        yield from _check_task(view, f"{at}.{task['name']}", task, before[task["name"]], tasks, known)


def _check_task(
    view: View, at: str, task: Document, before: set[str], tasks: list[Document], known: set[str]
) -> Iterator[str]:
    callee = view.templates.get(task.get("template", ""))
    if callee is None:
        yield f"{at}: no template {task.get('template')}; there are {', '.join(view.templates)}"
        return
    given, wanted = _collect_names(task, "arguments"), _collect_names(callee, "inputs")
    yield from (f"{at}: {callee['name']} has no input {n}" for n in sorted(given - wanted))
    yield from (f"{at}: {callee['name']} is not given its input {n}" for n in sorted(wanted - given))
    produced = {t["name"]: _collect_names(view.templates.get(t.get("template", ""), {}), "outputs") for t in tasks}
    for name in sorted(_find_placeholders(task)):
        match name.split("."):
            case ["item", *_] if "withParam" in task:
                continue
            case ["tasks", other, "outputs", "parameters", port]:
                if port not in produced.get(other, set()):
                    yield f"{at}: {other} has no output {port}"
                elif other not in before:
                    yield f"{at}: reads {other}, but does not wait for it"
            case _:
                if name not in known:
                    yield f"{at}: nothing is called {name}"


def _check_ports(view: View, pipeline: Pipeline, left_out: set[str]) -> Iterator[str]:
    sides = {n: t.get("metadata", {}).get("annotations", {}) for n, t in view.templates.items()}
    for name, template in view.containers():
        if name in pipeline.nodes:
            yield from _check_stage(name, template, sides[name], pipeline)
    scene = view.templates.get("scene", {}).get("dag", {}).get("tasks", [])
    there = {t.get("template") for t in scene} | left_out
    yield from (f"scene: no task runs {n}" for n in pipeline.order if n not in there)
    for task in scene:
        for argument in task.get("arguments", {}).get("parameters", []):
            for name in _find_placeholders(argument["value"]):
                parts = name.split(".")
                if parts[0] != "tasks" or parts[1] not in pipeline.nodes or task["template"] not in pipeline.nodes:
                    continue
                offered = json.loads(sides.get(parts[1], {}).get(f"{LABEL}/outputs", "{}")).get(parts[-1])
                wanted = json.loads(sides[task["template"]].get(f"{LABEL}/inputs", "{}"))
                port = argument["name"] if argument["name"] in wanted else argument["name"].rpartition("-")[0]
                if offered is None or port not in wanted or not is_compatible(offered, wanted[port]):
                    yield f"scene.{task['name']}: {port} takes {wanted.get(port)}, but {parts[1]} gives {offered}"


def _check_stage(name: str, template: Document, annotations: dict[str, str], pipeline: Pipeline) -> Iterator[str]:
    stage = pipeline.stages[name]
    if annotations.get(f"{LABEL}/stage") != stage.id:
        yield f"{name}: is for {annotations.get(f'{LABEL}/stage')}, but this pipeline has {stage.id}"
    outputs = {p["name"] for p in template.get("outputs", {}).get("parameters", [])}
    yield from (f"{name}: gives no output {p}" for p in stage.spec.outputs if p not in outputs)
    raw = [a["raw"]["data"] for a in template.get("inputs", {}).get("artifacts", []) if a["name"] == "invocation"]
    if not raw:
        yield f"{name}: has no invocation"
        return
    try:
        invocation = Invocation.model_validate_json(PLACEHOLDER.sub(ANY_DIGEST, raw[0]))
        resolve_parameters(pipeline, name, invocation.parameters)
    except ValidationError as error:
        yield f"{name}: its invocation is not the shim's: {first_error(error)}"
        return
    except ConfigurationError as error:
        yield f"{name}: {error}"
        return
    yield from (f"{name}: its invocation feeds {p}, no port" for p in invocation.inputs if p not in stage.spec.inputs)
    for port, declared in stage.spec.inputs.items():
        if not declared.optional and port not in invocation.inputs:
            yield f"{name}: its invocation leaves the port {port} empty"
