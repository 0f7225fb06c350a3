"""What the how-to tells a stranger is what the emitted manifests say."""

import re
import shlex

import yaml

from inpaint3d.contracts.models.cluster import ClusterSpec
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.stage import count_cpus
from inpaint3d.orchestrator.emit.argo import emit
from inpaint3d.orchestrator.emit.check import check
from tests.conftest import REPOSITORY
from tests.kubernetes.manifests import submission

GUIDE = (REPOSITORY / "docs/how-to/run-on-kubernetes.md").read_text()
PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")
CLUSTER, GPUS = (yaml.safe_load(block) for block in re.findall(r"^```yaml\n(.*?)^```", GUIDE, re.M | re.S))
UNITS = {"Mi": 2**20, "Gi": 2**30}


def emitted(**changes):
    body = {**CLUSTER, "spec": {**CLUSTER["spec"], **changes}}
    return emit(PIPELINE, ClusterSpec.model_validate(body), submission(PIPELINE, device="cuda" if changes else "cpu"))


def pods(documents):
    (template,) = [d for d in documents if d["kind"] == "WorkflowTemplate"]
    return [t for t in template["spec"]["templates"] if "container" in t]


def read_memory(quantity):
    return int(quantity[:-2]) * UNITS[quantity[-2:]]


def test_its_cluster_is_one_and_what_it_says_stands_in_every_pod():
    documents, spec = emitted(), CLUSTER["spec"]
    assert check(documents, PIPELINE) == []
    assert {d["metadata"]["namespace"] for d in documents} == {spec["namespace"]}
    for pod in pods(documents):
        container = pod["container"]
        assert container["envFrom"] == [{"secretRef": {"name": spec["credentialsSecret"]}}]
        assert {"name": "AWS_ENDPOINT_URL", "value": spec["endpoint"]} in container["env"]
        assert container["args"][container["args"].index("--store") + 1] == spec["store"]
    (template,) = [d["spec"] for d in documents if d["kind"] == "WorkflowTemplate"]
    assert template["ttlStrategy"] == {"secondsAfterCompletion": spec["secondsKept"]}


def test_its_kubectl_lines_make_what_its_cluster_names():
    lines = [shlex.split(line) for line in re.findall(r"^kubectl .*", GUIDE.replace("\\\n", " "), re.M)]
    made, labelled, secret = lines
    assert made[1:] == ["create", "namespace", CLUSTER["spec"]["namespace"]]
    assert labelled[3:] == [CLUSTER["spec"]["namespace"], "pod-security.kubernetes.io/enforce=restricted"]
    assert secret[1:3] == ["--namespace", CLUSTER["spec"]["namespace"]]
    assert secret[3:7] == ["create", "secret", "generic", CLUSTER["spec"]["credentialsSecret"]]
    names = [word.removeprefix("--from-literal=").partition("=")[0] for word in secret[7:]]
    assert names == ["AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"]


def test_its_account_may_do_what_it_says_and_no_more():
    (role,) = [d for d in emitted() if d["kind"] == "Role"]
    (rule,) = role["rules"]
    assert f"`{rule['verbs'][0]}` and `{rule['verbs'][1]}` of `{rule['resources'][0]}`" in GUIDE
    assert len(rule["verbs"]) == 2
    assert len(rule["resources"]) == 1


def test_its_smallest_node_takes_every_pod():
    text = " ".join(GUIDE.split())
    cores, gib = re.search(r"`standard` has (\d) CPU cores and (\d) GiB of memory", text).groups()
    asked = re.search(r"`largestCpuRequest` \((\d.\d) cores\) and (\d) GiB, and none may take more than (\d) GiB", text)
    cpu, memory, limit = (float(figure) for figure in asked.groups())
    resources = [pod["container"]["resources"] for pod in pods(emitted())]
    assert max(count_cpus(r["requests"]["cpu"]) for r in resources) == cpu < float(cores)
    assert max(read_memory(r["requests"]["memory"]) for r in resources) == memory * 2**30
    assert max(read_memory(r["limits"]["memory"]) for r in resources) == limit * 2**30 <= float(gib) * 2**30


def test_its_gpus_are_asked_for_by_the_stages_that_can_use_them():
    asked = {
        pod["name"]: pod["container"]["resources"]["limits"].get("nvidia.com/gpu") for pod in pods(emitted(**GPUS))
    }
    wants = {node: stage.spec.gpu != "none" for node, stage in PIPELINE.stages.items()}
    assert asked["joint-optimization"] == str(GPUS["gpu"]["count"])
    assert all((count is not None) == wants.get(node, False) for node, count in asked.items())
