"""What is given to a cluster and asked of it, with a kubectl that writes down what it was told."""

import json
import os
import sys

import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore, Record, open_store
from inpaint3d.orchestrator import cluster as clusters
from inpaint3d.orchestrator.emit.argo import LEFT_OUT
from inpaint3d.orchestrator.emit.check import check
from tests.conftest import REPOSITORY
from tests.kubernetes.manifests import DIGEST, TOY, cluster, submission

API_VERSION = "inpaint3d/v1"
PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")

KUBECTL = """#!{python}
import json, pathlib, sys
here = pathlib.Path(__file__).parent
with (here / "calls").open("a") as file:
    file.write(json.dumps([sys.argv[1:], "" if "-" not in sys.argv else sys.stdin.read()]) + "\\n")
answer = here / "answer"
if answer.exists():
    sys.stdout.write(answer.read_text())
else:
    sys.exit("E1: noise\\nthe server is out")
"""


@pytest.fixture
def kubectl(tmp_path, monkeypatch):
    """The folder of the kubectl on the PATH."""
    folder = tmp_path / "bin"
    folder.mkdir()
    (folder / "kubectl").write_text(KUBECTL.replace("{python}", sys.executable))
    (folder / "kubectl").chmod(0o755)
    (folder / "answer").write_text("{}")
    monkeypatch.setenv("PATH", str(folder))
    return folder


def calls(folder):
    return [json.loads(line) for line in (folder / "calls").read_text().splitlines()]


@pytest.fixture
def store(tmp_path):
    return FolderStore(tmp_path / "store")


def test_submit_applies_the_template_then_creates_the_workflows(store, kubectl):
    where = cluster(scenesPerWorkflow=1)
    documents = clusters.prepare(store, TOY, where, submission(TOY))
    assert clusters.submit(where, documents) == ["test-0000", "test-0001"]
    (applied, template), (created, workflows) = calls(kubectl)
    assert applied == ["--namespace", "inpaint3d", "apply", "-f", "-"]
    assert created == ["--namespace", "inpaint3d", "create", "-f", "-"]
    assert [yaml.safe_load(template), *yaml.safe_load_all(workflows)] == documents


@pytest.mark.parametrize("flags", [(), ("--compare",)])
def test_the_command_writes_what_is_wanted_and_says_what_is_left_out(cli, capture, bucket, tmp_path, flags):
    where = cluster(store=bucket, endpoint=os.environ["AWS_ENDPOINT_URL"])
    (tmp_path / "cluster.yaml").write_text(where.model_dump_json(by_alias=True))
    images = {name: image.model_dump() for name, image in submission(PIPELINE).images.items()}
    (tmp_path / "images.yaml").write_text(json.dumps({"apiVersion": API_VERSION, "kind": "Images", "spec": images}))
    files = ("--cluster", str(tmp_path / "cluster.yaml"), "--images", str(tmp_path / "images.yaml"))
    result = cli("emit", "argo", str(capture), "--name", "spring", "--seed", "3", *files, *flags)
    assert result.returncode == 0, result.stderr
    documents = list(yaml.safe_load_all(result.stdout))
    assert check(documents, PIPELINE) == []
    left_out = set(json.loads(documents[0]["metadata"]["annotations"][LEFT_OUT]))
    assert left_out == {"diffusion-training", "continued-reconstruction"} - (
        {"continued-reconstruction"} if flags else set()
    )
    submitted = clusters.load_submission(open_store(bucket), "spring")
    assert (submitted.compare, submitted.seed, submitted.preset) == (bool(flags), 3, "standard")
    wrong = cli("emit", "argo", str(capture), *files, "--set", "diffusion-training.steps=3")
    assert wrong.returncode == 2
    assert "diffusion-training is left out" in wrong.stderr


def test_status_tells_of_pods_and_waits(kubectl):
    nodes = {
        "1": {"name": "t.scene(0:n).a", "type": "Pod", "phase": "Failed", "message": "OOMKilled (exit code 137)"},
        "2": {"name": "t.scene(0:n)", "type": "DAG", "phase": "Running"},
        "3": {"name": "t.scene(0:n).await-mask", "type": "Suspend", "phase": "Running"},
    }
    workflow = {"metadata": {"name": "t"}, "status": {"phase": "Running", "nodes": nodes}}
    (kubectl / "answer").write_text(json.dumps({"items": [workflow]}))
    assert list(clusters.status(cluster(), "test")) == [
        ("t", "Running", ""),
        ("t.scene(0:n).a", "Failed", "OOMKilled (exit code 137)"),
        ("t.scene(0:n).await-mask", "Running", ""),
    ]
    (kubectl / "answer").write_text('{"items": []}')
    with pytest.raises(ConfigurationError, match="no Workflow of test"):
        list(clusters.status(cluster(), "test"))


def test_logs_are_those_of_the_stage_asked_for(kubectl):
    (kubectl / "answer").write_text("said")
    assert clusters.logs(cluster(), "test", "a") == "said"
    assert "inpaint3d/template=test,inpaint3d/node=a" in calls(kubectl)[0][0]


def test_rerun_forgets_the_stage_of_the_scene_and_runs_that_scene_again(store, kubectl):
    where = cluster()
    clusters.prepare(store, TOY, where, submission(TOY))
    runs = {
        s.name: clusters.record(store, TOY, submission(TOY, scenes=(s,)))[0].nodes[0] for s in submission(TOY).scenes
    }
    keys = {scene: run.key for scene, run in runs.items()}
    assert keys["kitchen"] == keys["n"], "the same capture"
    made = {"capture": store.put(store.private_folder(), "source", Source(name="a", kind="folder"))}
    components = runs["n"].components
    store.commit(
        Record(key=keys["n"], stage="ingest@0.1.0", components=components, outputs=made, provenance={}, timings={})
    )
    assert store.lookup(keys["n"]) is not None
    (name,) = clusters.rerun(store, TOY, where, "test", "ingest", ["n"])
    assert store.lookup(keys["n"]) is None
    (template, workflow) = (yaml.safe_load(document) for _, document in calls(kubectl))
    assert workflow["metadata"]["name"] == name != "test-0000"
    assert [s["name"] for s in json.loads(workflow["spec"]["arguments"]["parameters"][0]["value"])] == ["n"]
    assert check([template, workflow], TOY) == []
    with pytest.raises(ConfigurationError, match="test has no scene hall; it has kitchen, n"):
        clusters.rerun(store, TOY, where, "test", "ingest", ["hall"])
    with pytest.raises(ConfigurationError, match="nothing was submitted as tset; there are test"):
        clusters.rerun(store, TOY, where, "tset", "ingest", [])


def test_a_rerun_waits_for_no_mask_that_was_supplied(store, kubectl, tmp_path):
    clusters.prepare(store, TOY, cluster(), submission(TOY, awaitMasks=True))
    (tmp_path / "mask.yaml").write_text("mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}")
    digest = clusters.supply_mask(store, "test", "n", tmp_path / "mask.yaml")
    scenes = {s.name: s.externals for s in clusters.load_submission(store, "test").scenes}
    assert scenes == {"kitchen": {"capture": DIGEST}, "n": {"capture": DIGEST, "mask-request": digest}}
    waits = []
    for chosen in (["n"], ["kitchen"]):
        clusters.rerun(store, TOY, cluster(), "test", "ingest", chosen)
        template = yaml.safe_load(calls(kubectl)[-2][1])
        waits.append("await-mask" in {t["name"] for t in template["spec"]["templates"]})
    assert waits == [False, True]


def test_a_cluster_that_does_not_answer_is_said_in_its_words(kubectl):
    (kubectl / "answer").unlink()
    with pytest.raises(ConfigurationError, match="the server is out"):
        clusters.logs(cluster(), "test", None)


def test_kubectl_that_is_not_there_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigurationError, match="kubectl is not on the PATH"):
        clusters.logs(cluster(), "test", None)
