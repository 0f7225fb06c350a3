"""The pipeline as Argo Workflows: a WorkflowTemplate with a DAG for one scene, and Workflows that fan it out.

Mechanical: a template for each node, a task for each node, a parameter for each port. Only digests pass between pods;
the bulk goes through the store, and what a key already has is found there by the shim, so that nothing is memoised
here. The documents read as the YAML does; hera's typed models check them (`check_types`), `emit.check` the rest.
"""

import json
from typing import Any, cast

import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.cluster import ClusterSpec, Scene, Submission
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.orchestrator.configure import ConfiguredPipeline, configure_submission

Document = dict[str, Any]
API_VERSION = "argoproj.io/v1alpha1"
LABEL = "inpaint3d"
PRESET, LEFT_OUT = f"{LABEL}/preset", f"{LABEL}/left-out"
INVOCATION, OUTPUTS = "/inpaint3d/invocation.json", "/tmp/outputs"  # noqa: S108 - a path in a pod
RECORDER = "inpaint3d/orchestrator"
AWAIT = {"mask-request": "await-mask", "painted-views": "await-painting"}
"""External -> the step that waits for somebody to supply it."""
# The pod is gone (Error, or no exit code), it was told to go (143), or the stage says that another try may work (75).
# A stage that used up its memory (137) or its deadline would do so again.
RETRY = (
    '(lastRetry.status == "Error" || asInt(lastRetry.exitCode) in [-1, 75, 143])'
    ' && !(lastRetry.message contains "deadline")'
)


def emit(pipeline: Pipeline, cluster: ClusterSpec, submission: Submission, *, suffix: str = "") -> list[Document]:
    """A WorkflowTemplate, and a Workflow for every `scenesPerWorkflow` scenes, named with `suffix` and a number.

    Raises ConfigurationError.
    """
    configured = configure_submission(pipeline, submission)
    pipeline = configured.pipeline
    wanted = {RECORDER, *(spec.spec.image for spec in pipeline.stages.values())}
    if missing := sorted(wanted - set(submission.images)):
        raise ConfigurationError(f"images.yaml has no {', '.join(missing)}; run `make images`")
    template = _template(configured, cluster, submission)
    size = cluster.spec.scenesPerWorkflow
    batches = [submission.scenes[i : i + size] for i in range(0, len(submission.scenes), size)]
    names = [f"{submission.name}{suffix}-{i:04d}" for i in range(len(batches))]
    workflows = [_workflow(pipeline, cluster, submission, n, b) for n, b in zip(names, batches, strict=True)]
    return [check_types(document) for document in (template, *workflows)]


def check_types(document: Document) -> Document:
    """The document as hera's model of its kind has it. ConfigurationError where a field is not Argo's."""
    from hera.workflows import models
    from pydantic import ValidationError

    kinds: dict[str, Any] = {"WorkflowTemplate": models.WorkflowTemplate, "Workflow": models.Workflow}
    kind = document.get("kind")
    if kind not in kinds:
        raise ConfigurationError(f"kind {kind!r} is none of {', '.join(kinds)}")
    try:
        model = kinds[kind].model_validate(document)
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigurationError(f"{kind}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    kept = cast(Document, model.model_dump(mode="json", by_alias=True, exclude_none=True))
    # The models ignore what they do not know: a typo is what did not come back.
    if lost := _lost(document, kept):
        raise ConfigurationError(f"{kind}: Argo has no field {lost}")
    return kept


def _lost(given: Any, kept: Any, at: str = "") -> str | None:
    if isinstance(given, dict) and isinstance(kept, dict):
        for name, value in cast(Document, given).items():
            if name not in kept:
                return f"{at}.{name}".removeprefix(".")
            if found := _lost(value, kept[name], f"{at}.{name}"):
                return found
    if isinstance(given, list) and isinstance(kept, list):
        pairs = zip(cast(list[Any], given), cast(list[Any], kept), strict=True)
        return next((found for i, (g, k) in enumerate(pairs) if (found := _lost(g, k, f"{at}.{i}"))), None)
    return None


def dump(documents: list[Document]) -> str:
    """YAML that Kubernetes reads as it was meant."""
    return yaml.dump_all(documents, Dumper=_Dumper, sort_keys=False, width=120)


class _Dumper(yaml.SafeDumper):
    def represent_text(self, text: str) -> yaml.Node:
        # YAML 1.1, which Kubernetes reads, has `n` and `y` for booleans; PyYAML would leave them bare.
        quoted = text.lower() in ("y", "n")
        return cast(Any, self).represent_scalar("tag:yaml.org,2002:str", text, style='"' if quoted else None)


_Dumper.add_representer(str, _Dumper.represent_text)


def _template(configured: ConfiguredPipeline, cluster: ClusterSpec, submission: Submission) -> Document:
    body, pipeline = cluster.spec, configured.pipeline
    nodes = [_stage(configured, cluster, submission, node) for node in pipeline.order]
    waiting = [_await(external) for external in submission.awaited]
    spec: Document = {
        "entrypoint": "scenes",
        "onExit": "record",
        "arguments": {"parameters": [{"name": "scenes", "description": "a JSON list of scenes"}]},
        "parallelism": body.parallelism,
        "serviceAccountName": body.serviceAccountName,
        "podMetadata": {"labels": {f"{LABEL}/template": submission.name}},
        "securityContext": {"runAsNonRoot": True, "runAsUser": 10001, "runAsGroup": 10001, "fsGroup": 10001},
        "volumes": _volumes(cluster),
        "templates": [_scenes(pipeline), _scene(pipeline, submission), *nodes, *waiting, _record(cluster, submission)],
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


def _workflow(
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


def _scenes(pipeline: Pipeline) -> Document:
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


def _scene(pipeline: Pipeline, submission: Submission) -> Document:
    """The DAG of one scene."""
    tasks: list[Document] = []
    for node in pipeline.order:
        arguments = [{"name": p, "value": _source(r, submission)} for p, r in _ports(pipeline, node).items()]
        after = sorted(pipeline.upstream(node))
        for step in [AWAIT[e] for e in submission.awaited if f"external.{e}" in _ports(pipeline, node).values()]:
            # Where several nodes read it, the first one's inputs are there before anybody is asked.
            if all(task["name"] != step for task in tasks):
                tasks.append({"name": step, "template": step, "dependencies": sorted(pipeline.upstream(node))})
            after = [*after, step]
        task: Document = {"name": node, "template": node, "arguments": {"parameters": arguments}}
        tasks.append(task | ({"dependencies": after} if after else {}))
    inputs = [{"name": n} for n in ("name", *pipeline.spec.spec.externals)]
    return {"name": "scene", "inputs": {"parameters": inputs}, "dag": {"failFast": False, "tasks": tasks}}


def _ports(pipeline: Pipeline, node: str) -> dict[str, str]:
    """Parameter -> reference. A list port has a parameter for each item."""
    ports = pipeline.stages[node].spec.inputs
    found: dict[str, str] = {}
    for port, references in pipeline.references(node).items():
        for i, reference in enumerate(references):
            found[f"{port}-{i}" if ports[port].list else port] = reference
    return found


def _source(reference: str, submission: Submission) -> str:
    node, _, name = reference.partition(".")
    if node != "external":
        return f"{{{{tasks.{node}.outputs.parameters.{name}}}}}"
    if name in submission.awaited:
        return f"{{{{tasks.{AWAIT[name]}.outputs.parameters.{name}}}}}"
    return f"{{{{inputs.parameters.{name}}}}}"


def _stage(configured: ConfiguredPipeline, cluster: ClusterSpec, submission: Submission, node: str) -> Document:
    """The template of a node: the stage's image on the digests at its ports."""
    pipeline = configured.pipeline
    stage = pipeline.stages[node]
    ports = _ports(pipeline, node)
    on_gpu = submission.device == "cuda" and stage.spec.gpu != "none"
    template = _pod(
        cluster,
        submission,
        stage.spec.image,
        command=["inpaint3d-stage"],
        args=["run", "--store", cluster.spec.store, "--invocation", INVOCATION, "--outputs", OUTPUTS],
        resources=_resources(stage, cluster, on_gpu=on_gpu),
    )
    invocation = _invocation(configured, submission, node, device="cuda" if on_gpu else "cpu")
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
            "artifacts": [_file("invocation", INVOCATION, invocation)],
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


def _invocation(configured: ConfiguredPipeline, submission: Submission, node: str, *, device: str) -> str:
    """The shim's invocation, with Argo's placeholders where a digest will stand."""
    pipeline = configured.pipeline
    ports = pipeline.stages[node].spec.inputs
    inputs: dict[str, Any] = {}
    for parameter in _ports(pipeline, node):
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
            "threads": max(1, int(float(cpu))),
            "stub": submission.stub,
        },
        sort_keys=True,
    )


def _file(name: str, path: str, data: str) -> Document:
    # Readable by all: the stage is not root, and Argo writes the file as another user.
    return {"name": name, "path": path, "mode": 0o444, "raw": {"data": data}}


def _resources(stage: StageSpec, cluster: ClusterSpec, *, on_gpu: bool) -> Document:
    gpu = {cluster.spec.gpu.resource: str(cluster.spec.gpu.count)} if on_gpu else {}
    declared = stage.spec.resources
    return {"requests": dict(declared.requests), "limits": {**declared.limits, **gpu}}


def _pod(
    cluster: ClusterSpec,
    submission: Submission,
    image: str,
    *,
    command: list[str],
    args: list[str],
    resources: Document,
) -> Document:
    """What every pod has: the restricted security context, the cache, the way to the store, retries of lost pods."""
    body = cluster.spec
    env = [
        {"name": "INPAINT3D_IMAGE_DIGEST", "value": submission.images[image].digest},
        {"name": "INPAINT3D_CACHE", "value": "/cache"},
        {"name": "AWS_REGION", "value": body.region},
    ]
    if body.endpoint is not None:
        env.append({"name": "AWS_ENDPOINT_URL", "value": body.endpoint})
    container: Document = {
        "image": submission.images[image].image,
        "imagePullPolicy": body.imagePullPolicy,
        "command": command,
        "args": args,
        "env": env,
        "resources": resources,
        "volumeMounts": [{"name": "cache", "mountPath": "/cache"}, {"name": "tmp", "mountPath": "/tmp"}],  # noqa: S108
        "securityContext": {
            "runAsNonRoot": True,
            "runAsUser": 10001,
            "readOnlyRootFilesystem": True,
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"]},
            "seccompProfile": {"type": "RuntimeDefault"},
        },
    }
    if body.credentialsSecret is not None:
        container["envFrom"] = [{"secretRef": {"name": body.credentialsSecret}}]
    pod: Document = {
        "container": container,
        "retryStrategy": {
            "limit": str(body.retries),
            "retryPolicy": "Always",
            "expression": RETRY,
            "backoff": {"duration": "10s", "factor": "2", "maxDuration": "10m"},
        },
    }
    return pod | ({"tolerations": [dict(t) for t in body.tolerations]} if body.tolerations else {})


def _volumes(cluster: ClusterSpec) -> list[Document]:
    cache = cluster.spec.cache
    limit = {"sizeLimit": cache.sizeLimit} if cache.sizeLimit else {}
    claim: Document = {"persistentVolumeClaim": {"claimName": cache.claimName}}
    return [
        {"name": "cache", **(claim if cache.claimName else {"emptyDir": limit})},
        {"name": "tmp", "emptyDir": {}},
    ]


def _await(external: str) -> Document:
    """Waits for a person, who supplies the digest of what they made when resuming."""
    supplied: Document = {"name": external, "valueFrom": {"supplied": {}}}
    return {"name": AWAIT[external], "suspend": {}, "outputs": {"parameters": [supplied]}}


def _record(cluster: ClusterSpec, submission: Submission) -> Document:
    """The exit handler: writes the record of every scene's run to the store, however the Workflow ended."""
    scenes = "{{workflow.parameters.scenes}}"
    template = _pod(
        cluster,
        submission,
        RECORDER,
        command=["inpaint3d"],
        args=["record", submission.name, "--store", cluster.spec.store, "--scenes", scenes],
        resources={"requests": {"cpu": "100m", "memory": "256Mi"}, "limits": {"memory": "1Gi"}},
    )
    return template | {"name": "record", "activeDeadlineSeconds": 3600}
