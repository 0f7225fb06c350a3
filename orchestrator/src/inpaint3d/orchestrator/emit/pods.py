"""The pods of stages: they pass the `restricted` pod security standard and quotas, and are tried again when lost."""

from typing import Any

from inpaint3d.contracts.kit.process import LAST_WORDS
from inpaint3d.contracts.models.cluster import ClusterSpec, Submission
from inpaint3d.contracts.models.stage import StageSpec, count_cpus

Document = dict[str, Any]
# The pod is gone (Error, or no exit code), it was told to go (143), or the stage says that another try may work (75).
# A stage that used up its memory (137) or its deadline would do so again.
RETRY = (
    '(lastRetry.status == "Error" || asInt(lastRetry.exitCode) in [-1, 75, 143])'
    ' && !(lastRetry.message contains "deadline")'
)


def write_pod(
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
        {"name": LAST_WORDS, "value": "/dev/termination-log"},
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
        "securityContext": {**restricted_context(), "readOnlyRootFilesystem": True},
    }
    if body.credentialsSecret is not None:
        container["envFrom"] = [{"secretRef": {"name": body.credentialsSecret}}]
    pod: Document = {
        "container": container,
        "retryStrategy": {
            "limit": str(body.retries),
            "retryPolicy": "Always",
            "expression": RETRY,
            # No maxDuration: it counts from the first try's start, and would end a retry that works.
            "backoff": {"duration": "10s", "factor": "2"},
        },
    }
    return pod | ({"tolerations": [dict(t) for t in body.tolerations]} if body.tolerations else {})


def choose_resources(stage: StageSpec, cluster: ClusterSpec, *, on_gpu: bool) -> Document:
    gpu = {cluster.spec.gpu.resource: str(cluster.spec.gpu.count)} if on_gpu else {}
    declared = stage.spec.resources
    cpu = min(declared.requests.get("cpu", "1"), cluster.spec.largestCpuRequest, key=count_cpus)
    # A quota on limits wants one of every container.
    limits = {"cpu": max(cpu, declared.requests.get("cpu", "1"), key=count_cpus), **declared.limits, **gpu}
    return {"requests": {**declared.requests, "cpu": cpu}, "limits": limits}


def list_volumes(cluster: ClusterSpec) -> list[Document]:
    cache = cluster.spec.cache
    limit = {"sizeLimit": cache.sizeLimit} if cache.sizeLimit else {}
    claim: Document = {"persistentVolumeClaim": {"claimName": cache.claimName}}
    return [
        {"name": "cache", **(claim if cache.claimName else {"emptyDir": limit})},
        {"name": "tmp", "emptyDir": {}},
    ]


def patch_argo_containers() -> Document:
    """What Argo adds to each pod, made to pass the `restricted` pod security standard and a quota on resources."""
    shared: Document = {
        "resources": {"requests": {"cpu": "10m", "memory": "64Mi"}, "limits": {"cpu": "500m", "memory": "256Mi"}},
        "securityContext": restricted_context(),
    }
    return {"initContainers": [{"name": "init", **shared}], "containers": [{"name": "wait", **shared}]}


def restricted_context() -> Document:
    """The security context that every container has."""
    return {
        "runAsNonRoot": True,
        "runAsUser": 10001,
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
        "seccompProfile": {"type": "RuntimeDefault"},
    }
