"""The pipeline as Argo Workflows: a WorkflowTemplate with a DAG for one scene, and Workflows that fan it out.

Mechanical: a template for each node, a task for each node, a parameter for each port. Only digests pass between pods;
the bulk goes through the store, and what a key already has is found there by the shim, so that nothing is memoised
here. The documents read as the YAML does; hera's typed models check them (`emit.documents`), `emit.check` the rest.
"""

import json
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.cluster import ClusterSpec, Scene, Submission
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.stage import count_cpus
from inpaint3d.orchestrator.configure import ConfiguredPipeline, configure_submission
from inpaint3d.orchestrator.emit.documents import Document, check_types
from inpaint3d.orchestrator.emit.pods import choose_resources, list_volumes, patch_argo_containers, write_pod
from inpaint3d.orchestrator.emit.service_account import write_service_account

API_VERSION = "argoproj.io/v1alpha1"
LABEL = "inpaint3d"
ASKED = f"{LABEL}/asked"
"""Of a Workflow: the digest of all that it asks for, by which `submit` knows what the cluster has already."""
KEPT_AFTER_SUCCESS = "1h"
"""How long a pod that did its work stays, for its log; those that failed stay as long as their Workflow."""
PRESET, LEFT_OUT = f"{LABEL}/preset", f"{LABEL}/left-out"
INVOCATION, OUTPUTS = "/inpaint3d/invocation.json", "/tmp/outputs"  # noqa: S108 - a path in a pod
RECORDER = "inpaint3d/orchestrator"
AWAIT = {"mask-request": "await-mask", "painted-views": "await-painting"}
"""External -> the step that waits for somebody to supply it."""


def emit(pipeline: Pipeline, cluster: ClusterSpec, submission: Submission, *, suffix: str = "") -> list[Document]:
    """The service account, a WorkflowTemplate, and a Workflow for every `scenesPerWorkflow` scenes, named with `suffix`
    and a number.

    Raises ConfigurationError.
    """
    configured = configure_submission(pipeline, submission)
    pipeline = configured.pipeline
    wanted = {RECORDER, *(spec.spec.image for spec in pipeline.stages.values())}
    if missing := sorted(wanted - set(submission.images)):
        raise ConfigurationError(f"images.yaml has no {', '.join(missing)}; run `make images`")
    template = _make_template(configured, cluster, submission)
    size = cluster.spec.scenesPerWorkflow
    batches = [submission.scenes[i : i + size] for i in range(0, len(submission.scenes), size)]
    names = [f"{submission.name}{suffix}-{i:04d}" for i in range(len(batches))]
    workflows = [_make_workflow(pipeline, cluster, submission, n, b) for n, b in zip(names, batches, strict=True)]
    account = write_service_account(cluster) if cluster.spec.createServiceAccount else []
    for workflow in workflows:
        workflow["metadata"]["annotations"] = {ASKED: digest_of([template["spec"], workflow["spec"]])}
    return [*account, *map(check_types, (template, *workflows))]


def _make_template(configured: ConfiguredPipeline, cluster: ClusterSpec, submission: Submission) -> Document:
    body, pipeline = cluster.spec, configured.pipeline
    nodes = [_make_stage(configured, cluster, submission, node) for node in pipeline.order]
    waiting = [_await(external) for external in submission.awaited]
    spec: Document = {
        "entrypoint": "scenes",
        "onExit": "record",
        "arguments": {"parameters": [{"name": "scenes", "description": "a JSON list of scenes"}]},
        "parallelism": body.parallelism,
        "serviceAccountName": body.serviceAccountName,
        "podMetadata": {"labels": {f"{LABEL}/template": submission.name}},
        "securityContext": {"runAsNonRoot": True, "runAsUser": 10001, "runAsGroup": 10001, "fsGroup": 10001},
        "volumes": list_volumes(cluster),
        "podSpecPatch": json.dumps(patch_argo_containers(), sort_keys=True),
        "ttlStrategy": {"secondsAfterCompletion": body.secondsKept},
        "podGC": {"strategy": "OnPodSuccess", "deleteDelayDuration": KEPT_AFTER_SUCCESS},
        "templates": [
            _fan_out(pipeline),
            _make_scene(pipeline, submission),
            *nodes,
            *waiting,
            _record(cluster, submission),
        ],
    }
    if body.priorityClassName is not None:
        spec["podPriorityClassName"] = body.priorityClassName
    return {
        "apiVersion": API_VERSION,
        "kind": "WorkflowTemplate",
        "metadata": {
            "name": submission.name,
            "namespace": body.namespace,
            "annotations": {PRESET: submission.preset or "", LEFT_OUT: json.dumps(configured.left_out)},
        },
        "spec": spec,
    }


def _make_workflow(
    pipeline: Pipeline, cluster: ClusterSpec, submission: Submission, name: str, scenes: tuple[Scene, ...]
) -> Document:
    externals = pipeline.spec.spec.externals
    listed = [{"name": s.name, **{e: s.externals.get(e, "") for e in externals}} for s in scenes]
    return {
        "apiVersion": API_VERSION,
        "kind": "Workflow",
        "metadata": {
            "name": name,
            "namespace": cluster.spec.namespace,
            "labels": {f"{LABEL}/submission": submission.name},
        },
        "spec": {
            "workflowTemplateRef": {"name": submission.name},
            "arguments": {"parameters": [{"name": "scenes", "value": json.dumps(listed)}]},
        },
    }


def _fan_out(pipeline: Pipeline) -> Document:
    """Fan-out: one `scene` for each item of the list."""
    names = ["name", *pipeline.spec.spec.externals]
    task = {
        "name": "scene",
        "template": "scene",
        "withParam": "{{workflow.parameters.scenes}}",
        "arguments": {"parameters": [{"name": n, "value": f"{{{{item.{n}}}}}"} for n in names]},
    }
    # One scene that fails is no reason to stop the others.
    return {"name": "scenes", "dag": {"failFast": False, "tasks": [task]}}


def _make_scene(pipeline: Pipeline, submission: Submission) -> Document:
    """The DAG of one scene."""
    tasks: list[Document] = []
    for node in pipeline.order:
        arguments = [{"name": p, "value": _name_source(r, submission)} for p, r in _list_ports(pipeline, node).items()]
        after = sorted(pipeline.upstream(node))
        for step in [AWAIT[e] for e in submission.awaited if f"external.{e}" in _list_ports(pipeline, node).values()]:
            # Where several nodes read it, the first one's inputs are there before anybody is asked.
            if all(task["name"] != step for task in tasks):
                tasks.append({"name": step, "template": step, "dependencies": sorted(pipeline.upstream(node))})
            after = [*after, step]
        task: Document = {"name": node, "template": node, "arguments": {"parameters": arguments}}
        tasks.append(task | ({"dependencies": after} if after else {}))
    inputs = [{"name": n} for n in ("name", *pipeline.spec.spec.externals)]
    return {"name": "scene", "inputs": {"parameters": inputs}, "dag": {"failFast": False, "tasks": tasks}}


def _list_ports(pipeline: Pipeline, node: str) -> dict[str, str]:
    """Parameter -> reference. A list port has a parameter for each item."""
    ports = pipeline.stages[node].spec.inputs
    found: dict[str, str] = {}
    for port, references in pipeline.references(node).items():
        for i, reference in enumerate(references):
            found[f"{port}-{i}" if ports[port].list else port] = reference
    return found


def _name_source(reference: str, submission: Submission) -> str:
    node, _, name = reference.partition(".")
    if node != "external":
        return f"{{{{tasks.{node}.outputs.parameters.{name}}}}}"
    if name in submission.awaited:
        return f"{{{{tasks.{AWAIT[name]}.outputs.parameters.{name}}}}}"
    return f"{{{{inputs.parameters.{name}}}}}"


def _make_stage(configured: ConfiguredPipeline, cluster: ClusterSpec, submission: Submission, node: str) -> Document:
    """The template of a node: the stage's image on the digests at its ports."""
    pipeline = configured.pipeline
    stage = pipeline.stages[node]
    ports = _list_ports(pipeline, node)
    on_gpu = submission.device == "cuda" and stage.spec.gpu != "none"
    template = write_pod(
        cluster,
        submission,
        stage.spec.image,
        command=["inpaint3d-stage"],
        args=["run", "--store", cluster.spec.store, "--invocation", INVOCATION, "--outputs", OUTPUTS],
        resources=choose_resources(stage, cluster, on_gpu=on_gpu),
    )
    invocation = _make_invocation(configured, submission, node, device="cuda" if on_gpu else "cpu")
    selector = {**cluster.spec.nodeSelector, **(cluster.spec.gpu.nodeSelector if on_gpu else {})}
    template |= {
        "name": node,
        "metadata": {
            "labels": {f"{LABEL}/node": node},
            "annotations": {
                f"{LABEL}/stage": stage.id,
                f"{LABEL}/inputs": json.dumps({p: d.schema_range for p, d in stage.spec.inputs.items()}),
                f"{LABEL}/outputs": json.dumps({p: d.schema_id for p, d in stage.spec.outputs.items()}),
            },
        },
        "inputs": {
            "parameters": [{"name": p} for p in ports],
            "artifacts": [_make_file("invocation", INVOCATION, invocation)],
        },
        "outputs": {
            "parameters": [
                {"name": p, "valueFrom": {"path": f"{OUTPUTS}/{p}"}} for p in stage.spec.outputs
            ]
        },
    }  # fmt: skip
    if stage.spec.activeDeadlineSeconds is not None:
        template["activeDeadlineSeconds"] = stage.spec.activeDeadlineSeconds
    return template | ({"nodeSelector": selector} if selector else {})


def _make_invocation(configured: ConfiguredPipeline, submission: Submission, node: str, *, device: str) -> str:
    """The shim's invocation, with Argo's placeholders where a digest will stand."""
    pipeline = configured.pipeline
    ports = pipeline.stages[node].spec.inputs
    inputs: dict[str, Any] = {}
    for parameter in _list_ports(pipeline, node):
        value, port = f"{{{{inputs.parameters.{parameter}}}}}", parameter
        if parameter not in ports:
            port = parameter.rpartition("-")[0]
            inputs.setdefault(port, []).append(value)
        else:
            inputs[port] = value
    resources = pipeline.stages[node].spec.resources
    cpu = resources.limits.get("cpu", resources.requests.get("cpu", "1"))
    return json.dumps(
        {
            "parameters": configured.parameters[node],
            "inputs": inputs,
            "seed": configured.seeds[node],
            "device": device,
            "threads": max(1, int(count_cpus(cpu))),
            "stub": submission.stub,
            **({"accept_doubtful": True} if submission.acceptDoubtful else {}),
        },
        sort_keys=True,
    )


def _make_file(name: str, path: str, data: str) -> Document:
    # Readable by all: the stage is not root, and Argo writes the file as another user.
    return {"name": name, "path": path, "mode": 0o444, "raw": {"data": data}}


def _await(external: str) -> Document:
    """Waits for a person, who supplies the digest of what they made when resuming."""
    supplied: Document = {"name": external, "valueFrom": {"supplied": {}}}
    return {"name": AWAIT[external], "suspend": {}, "outputs": {"parameters": [supplied]}}


def _record(cluster: ClusterSpec, submission: Submission) -> Document:
    """The exit handler: writes the record of every scene's run to the store, however the Workflow ended."""
    scenes, since = "{{workflow.parameters.scenes}}", "{{workflow.creationTimestamp}}"
    template = write_pod(
        cluster,
        submission,
        RECORDER,
        command=["inpaint3d"],
        args=["record", submission.name, "--store", cluster.spec.store, "--scenes", scenes, "--since", since],
        resources={"requests": {"cpu": "100m", "memory": "256Mi"}, "limits": {"cpu": "1", "memory": "1Gi"}},
    )
    return template | {"name": "record", "activeDeadlineSeconds": 3600}
