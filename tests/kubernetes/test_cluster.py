"""Every image as a Job of a real cluster, with the pod that is emitted for Argo: `make test-kubernetes`.

Needs kubectl pointed at a cluster whose nodes have the images, INPAINT3D_CLUSTER (a cluster.yaml whose store both the
pods and this process reach), INPAINT3D_IMAGES, and AWS_ACCESS_KEY_ID with AWS_SECRET_ACCESS_KEY.
"""

import csv
import io
import json
import os
import secrets
import shutil
import subprocess
import time
from pathlib import Path

import pytest
import yaml

from inpaint3d.contracts.kit.upstream import Upstream, store_externals
from inpaint3d.contracts.models.cluster import ClusterSpec, ImagesSpec, Scene, Submission
from inpaint3d.contracts.models.documents import load_document, load_yaml
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store.bucket import BucketStore
from inpaint3d.orchestrator.emit.argo import RECORDER, emit
from tests.conftest import REPOSITORY
from tests.kubernetes.jobs import Cluster, job_of

pytestmark = pytest.mark.kubernetes
PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
TRAINING, JOINT = "diffusion-training", "joint-optimization"
TINY = load_yaml(REPOSITORY / "stages" / "diffusion_training" / "tests" / "tiny.yaml")[0] | {"steps": 200}
JOINT_YAML = load_yaml(REPOSITORY / "stages" / "joint_optimization" / "tests" / "tiny.yaml")[0]
# What counts for a fresh field alone is refused beside the initial field.
TINY_JOINT = {n: v for n, v in JOINT_YAML.items() if n != "architecture"} | {"ranks": 2}
TINY_JOINT["estimator"] = {n: v for n, v in JOINT_YAML["estimator"].items() if n != "warmup_steps"}
EVERY_NODE = {"compare": True, "overrides": {JOINT: {"estimator": "sds"}}}
TWO_PODS = Path(__file__).with_name("two_pods.py")


def why_not():
    """What is missing for these tests, or None."""
    for name in ("INPAINT3D_CLUSTER", "INPAINT3D_IMAGES", "AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        if name not in os.environ:
            return f"{name} is not set"
    if shutil.which("kubectl") is None:
        return "there is no kubectl"
    ready = subprocess.run(["kubectl", "get", "nodes"], capture_output=True, text=True, check=False)
    return None if ready.returncode == 0 else f"no cluster answers: {ready.stderr.strip()[-200:]}"


@pytest.fixture(scope="module")
def where():
    if reason := why_not():
        pytest.skip(reason)
    return load_document(Path(os.environ["INPAINT3D_CLUSTER"]), ClusterSpec)[0]


@pytest.fixture(scope="module")
def cluster(where):
    """A namespace of the test's own, with the Secret that the manifests refer to."""
    cluster = Cluster(f"inpaint3d-test-{secrets.token_hex(3)}")
    cluster.kubectl("create", "namespace", cluster.namespace)
    if where.spec.credentialsSecret:
        keys = [f"--from-literal={n}={os.environ[n]}" for n in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY")]
        cluster.kubectl("create", "secret", "generic", where.spec.credentialsSecret, *keys)
    yield cluster
    cluster.kubectl("delete", "namespace", cluster.namespace, "--wait=false")


@pytest.fixture(scope="module")
def place(where):
    return f"{where.spec.store}/{secrets.token_hex(4)}"


@pytest.fixture(scope="module")
def store(where, place, tmp_path_factory):
    if where.spec.endpoint:
        os.environ["AWS_ENDPOINT_URL"] = where.spec.endpoint
    return BucketStore(place, tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def externals(store):
    return {r.removeprefix("external."): d for r, d in store_externals(store).items()}


@pytest.fixture(scope="module")
def images(where):
    return load_document(Path(os.environ["INPAINT3D_IMAGES"]), ImagesSpec)[0].spec


@pytest.fixture(scope="module")
def template(where, place, externals, images):
    """Options of a submission -> its WorkflowTemplate for the test's store."""

    def made(**options):
        at = where.model_copy(update={"spec": where.spec.model_copy(update={"store": place})})
        scene = Scene(name="tiny", externals=externals)
        asked = submission_of(images, scene, **options)
        return emit(PIPELINE, at, asked)[0]

    return made


def submission_of(images, scene, **options):
    """One in which every node runs."""
    overrides = EVERY_NODE["overrides"] | options.pop("overrides", {})
    asked = {"name": "test", "preset": None, "images": images, "scenes": (scene,), **EVERY_NODE, **options}
    return Submission(**(asked | {"overrides": overrides}))


def values_of(node, produced):
    """The input parameters of a node, from what the nodes before it gave."""
    ports = PIPELINE.stages[node].spec.inputs
    values = {}
    for port, references in PIPELINE.references(node).items():
        for i, reference in enumerate(references):
            values[f"{port}-{i}" if ports[port].list else port] = produced.get(reference, "")
    return values


@pytest.fixture(scope="module")
def produced(cluster, template, externals):
    """Every image, one after the other, on what those before it left in the store; reference -> digest."""
    stubs = template(stub=True)
    produced = {f"external.{n}": d for n, d in externals.items()}
    for node in PIPELINE.order:
        began = time.monotonic()
        cluster.apply(job_of(stubs, node, f"stub-{node}", values_of(node, produced)))
        assert cluster.ended(f"stub-{node}") == "Complete", cluster.events(f"stub-{node}")
        made = cluster.outputs(f"stub-{node}")
        cluster.say(f"{node}: Complete in {time.monotonic() - began:.1f} s: {', '.join(made)}")
        produced |= {f"{node}.{port}": digest for port, digest in made.items()}
    return produced


def test_every_image_reads_and_writes_the_bucket(produced, store, images):
    for node in PIPELINE.order:
        required = {p for p, d in PIPELINE.stages[node].spec.outputs.items() if not d.optional}
        assert {f"{node}.{p}" for p in required} <= set(produced)
    digests = [d for reference, d in produced.items() if not reference.startswith("external.")]
    assert all(store.find_damage(d) is None for d in digests)
    built = {image.digest for image in images.values()}
    stubs = [r for r in store.records() if r.components.get("stub") and r.components["code"] in built]
    assert len(stubs) == len(PIPELINE.order)


def test_pods_are_restricted(cluster, produced):
    pods = cluster.get("pods")["items"]
    assert len(pods) >= len(PIPELINE.order)
    for pod in pods:
        context = pod["spec"]["containers"][0]["securityContext"]
        assert context["readOnlyRootFilesystem"]
        assert context["capabilities"]["drop"] == ["ALL"]
        assert context["seccompProfile"]["type"] == "RuntimeDefault"
        assert pod["spec"]["securityContext"]["runAsNonRoot"]


@pytest.fixture(scope="module")
def inputs(store, tmp_path_factory):
    """What the training and the joint optimisation read, by stubs as processes of this machine."""
    os.environ["INPAINT3D_CACHE"] = str(tmp_path_factory.mktemp("stubs"))
    return {node: values_of(node, Upstream(PIPELINE, node, store).produced) for node in (TRAINING, JOINT)}


def training(template, name, inputs, memory=None):
    """A Job of the real training, long enough to be disturbed."""
    documents = job_of(template(overrides={TRAINING: TINY}), TRAINING, name, inputs[TRAINING])
    if memory:
        container = documents[1]["spec"]["template"]["spec"]["containers"][0]
        container["resources"] = {kind: {"cpu": "500m", "memory": memory} for kind in ("requests", "limits")}
    return documents


def records_of(store, stage):
    return [r for r in store.records() if r.stage.startswith(stage) and not r.components.get("stub")]


def test_too_little_memory_fails_without_a_retry_and_more_repairs_it(cluster, template, inputs, store):
    cluster.apply(training(template, "hungry", inputs, memory="256Mi"))
    assert cluster.ended("hungry") == "PodFailurePolicy"
    (pod,) = cluster.pods("hungry")
    state = pod["status"]["containerStatuses"][0]["state"]["terminated"]
    assert (state["reason"], state["exitCode"]) == ("OOMKilled", 137)
    assert records_of(store, TRAINING) == []
    cluster.say(f"256Mi: {state['reason']}, exit {state['exitCode']}, no retry, nothing committed")
    cluster.apply(training(template, "fed", inputs))
    assert cluster.ended("fed") == "Complete"
    cluster.say("with the limit of stage.yaml: Complete")


def disturb(cluster, name, how):
    """Do something to a Job's pod when it is at work; the phases of its pods when all is over."""
    pod = cluster.works(name)
    how(pod)
    assert cluster.ended(name) == "Complete"
    return [p["status"]["phase"] for p in cluster.pods(name)]


@pytest.mark.parametrize("how", ["evicted", "deleted"])
def test_a_lost_pod_is_tried_again_and_gives_the_same_bytes(cluster, template, inputs, store, how):
    if not records_of(store, TRAINING):
        cluster.apply(training(template, "undisturbed", inputs))
        assert cluster.ended("undisturbed") == "Complete"
    (record,) = records_of(store, TRAINING)
    store.forget(record.key)

    def evict(pod):
        body = {"apiVersion": "policy/v1", "kind": "Eviction", "metadata": {"name": pod}}
        path = f"/api/v1/namespaces/{cluster.namespace}/pods/{pod}/eviction"
        cluster.kubectl("create", "--raw", path, "-f", "-", stdin=json.dumps(body))

    def delete(pod):
        cluster.kubectl("delete", "pod", pod, "--wait=false")

    cluster.apply(training(template, how, inputs))
    phases = disturb(cluster, how, evict if how == "evicted" else delete)
    assert phases[-1] == "Succeeded"
    assert cluster.get("job", how)["status"]["succeeded"] == 1
    assert cluster.outputs(how) == record.outputs
    cluster.say(f"{how} half-way: tried again, the same digests as undisturbed; pods left: {phases}")


def test_two_pods_learn_what_one_does(cluster, template, place, store):
    """An Indexed Job with torchrun (gloo between the pods' addresses) against one process on both halves of a batch."""
    tiny = TINY | {"parts": 2, "steps": 6, "curve_rows": 3}
    for pods in (1, 2):
        documents = job_of(template(), TRAINING, f"ranks-{pods}", {})
        documents[0]["data"]["config.yaml"] = yaml.safe_dump(tiny)
        cluster.apply(indexed(documents, place, pods, "training"))
    curves = {}
    for pods in (1, 2):
        assert cluster.ended(f"ranks-{pods}") == "Complete", cluster.kubectl("logs", "-l", f"job-name=ranks-{pods}")
        text = (store.read(f"curves/ranks-{pods}") or b"").decode()
        curves[pods] = [[float(v) for v in row] for row in list(csv.reader(io.StringIO(text)))[1:]]
    assert len(curves[2]) >= 3
    worst = 0.0
    for one, two in zip(curves[1], curves[2], strict=True):
        # Sums in another order, six steps long; the table has six digits.
        assert two == pytest.approx(one, rel=1e-4)
        worst = max(worst, *(abs(a - b) / max(abs(a), 1e-12) for a, b in zip(one, two, strict=True)))
    cluster.say(f"two pods against one: {len(curves[2])} rows of the curve, largest relative difference {worst:.1e}")


def test_two_pods_optimise_what_two_ranks_of_one_pod_do(cluster, template, inputs, place, store):
    """The same key, and the same digest, whether the second rank is a process of the stage's own pod or a pod."""
    joint = template(overrides={JOINT: TINY_JOINT})
    cluster.apply(job_of(joint, JOINT, "joint-1", inputs[JOINT]))
    assert cluster.ended("joint-1") == "Complete", cluster.events("joint-1")
    (record,) = records_of(store, JOINT)
    store.forget(record.key)
    began = time.monotonic()
    cluster.apply(indexed(job_of(joint, JOINT, "joint-2", inputs[JOINT]), place, 2, "joint"))
    assert cluster.ended("joint-2") == "Complete", cluster.kubectl("logs", "-l", "job-name=joint-2")
    assert len(cluster.pods("joint-2")) == 2
    assert [r.outputs for r in records_of(store, JOINT)] == [record.outputs]
    took = time.monotonic() - began
    cluster.say(f"joint optimisation, two pods against two ranks of one: the same digests, in {took:.1f} s")


def indexed(documents, place, pods, what):
    """A stage's pod as an Indexed Job that runs `two_pods.py`."""
    files, job = documents
    files["data"]["two_pods.py"] = TWO_PODS.read_text()
    container = job["spec"]["template"]["spec"]["containers"][0]
    container["command"] = ["python", "/inpaint3d/two_pods.py"]
    container["args"] = [place, job["metadata"]["name"], str(pods), what]
    container["env"].append({"name": "POD_IP", "valueFrom": {"fieldRef": {"fieldPath": "status.podIP"}}})
    container["resources"] = {"requests": {"cpu": "500m", "memory": "1Gi"}, "limits": {"memory": "4Gi"}}
    mounts = [m for m in container["volumeMounts"] if m["name"] != "files"]
    container["volumeMounts"] = [*mounts, {"name": "files", "mountPath": "/inpaint3d", "readOnly": True}]
    job["spec"] |= {"completionMode": "Indexed", "completions": pods, "parallelism": pods}
    return documents


def test_the_recorder_writes_the_run(cluster, template, produced, store, externals, place, images):
    """The orchestrator's image as the exit handler."""
    scene = Scene(name="tiny", externals=externals)
    asked = submission_of(images, scene, stub=True)
    store.write("submissions/test.json", asked.model_dump_json().encode())
    documents = job_of(template(stub=True), "record", "record", {})
    container = documents[1]["spec"]["template"]["spec"]["containers"][0]
    assert container["image"] == images[RECORDER].image
    container["args"] = ["record", "test", "--store", place]
    cluster.apply(documents)
    assert cluster.ended("record") == "Complete"
    (name,) = store.names("runs/tiny")
    assert json.loads(store.read(f"runs/tiny/{name}"))["status"] == "done"
