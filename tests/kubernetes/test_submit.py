"""What is given to a cluster and asked of it, with a kubectl that writes down what it was told."""

import datetime
import json
import os
import re
import sys
import time
from pathlib import Path

import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import FolderStore, Record, open_store
from inpaint3d.orchestrator import cluster as clusters
from inpaint3d.orchestrator.cluster_cli import status
from inpaint3d.orchestrator.emit.argo import LEFT_OUT
from inpaint3d.orchestrator.emit.check import check
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import MASK_REQUEST
from inpaint3d.orchestrator.workflows import list_rows
from tests.conftest import REPOSITORY
from tests.kubernetes.manifests import DIGEST, TOY, cluster, submission

API_VERSION = "inpaint3d/v1"
PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")

KUBECTL = """#!{python}
import json, pathlib, sys
here = pathlib.Path(__file__).parent
with (here / "calls").open("a") as file:
    file.write(json.dumps([sys.argv[1:], "" if "-" not in sys.argv else sys.stdin.read()]) + "\\n")
verb = next(a for a in sys.argv[3:] if not a.startswith("-"))
answers = [here / f"answer.{verb}", here / "answer"]
answer = next((a for a in answers if a.exists()), answers[-1])
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
    (kubectl / "answer.get").write_text("")
    assert clusters.submit(where, documents) == {"test-0000": "started", "test-0001": "started"}
    (asked, _), (applied, shared), (created, workflows) = calls(kubectl)
    assert asked[2:4] == ["get", "workflows.argoproj.io"]
    assert applied == ["--namespace", "inpaint3d", "apply", "-f", "-"]
    assert created == ["--namespace", "inpaint3d", "create", "-f", "-"]
    assert [*yaml.safe_load_all(shared), *yaml.safe_load_all(workflows)] == documents


def test_submit_of_what_is_there_does_nothing_and_says_so(store, kubectl):
    where = cluster(scenesPerWorkflow=1)
    documents = clusters.prepare(store, TOY, where, submission(TOY))
    there = [{**d, "status": {"phase": "Running"}} for d in documents if d["kind"] == "Workflow"]
    (kubectl / "answer.get").write_text(json.dumps({"items": there}))
    already = {"test-0000": "there already (Running)", "test-0001": "there already (Running)"}
    assert clusters.submit(where, documents) == already
    assert len(calls(kubectl)) == 1, "nothing was applied"
    (kubectl / "answer.get").write_text(json.dumps(there[0]))  # of one that is found kubectl gives no list
    assert clusters.submit(where, documents) == {**already, "test-0001": "started"}
    _, (_, workflows) = calls(kubectl)[-2:]
    assert [w["metadata"]["name"] for w in yaml.safe_load_all(workflows)] == ["test-0001"]


def test_submit_of_something_else_under_a_name_is_refused(store, kubectl):
    documents = clusters.prepare(store, TOY, cluster(), submission(TOY))
    other = clusters.prepare(store, TOY, cluster(), submission(TOY, seed=3), replace=True)
    (kubectl / "answer.get").write_text(json.dumps(documents[-1]))
    with pytest.raises(ConfigurationError, match="another Workflow test-0000; emit under another --name"):
        clusters.submit(cluster(), other)


def test_what_was_emitted_under_a_name_is_replaced_only_where_that_is_asked_for(store):
    clusters.prepare(store, TOY, cluster(), submission(TOY))
    clusters.prepare(store, TOY, cluster(), submission(TOY))
    with pytest.raises(ConfigurationError, match="--name test: something else was emitted under it"):
        clusters.prepare(store, TOY, cluster(), submission(TOY, seed=3))
    assert clusters.load_submission(store, "test").seed == 0
    clusters.prepare(store, TOY, cluster(), submission(TOY, seed=3), replace=True)
    assert clusters.load_submission(store, "test").seed == 3


def test_the_record_of_scenes_that_are_gone_is_an_error(cli, store):
    clusters.prepare(store, TOY, cluster(), submission(TOY))
    result = cli("record", "test", "--store", str(store.root), "--scenes", '[{"name": "hall"}]')
    assert result.returncode == 2
    assert "test has no scene hall: it was emitted again with other scenes" in result.stderr


def test_a_record_says_how_long_its_workflow_took(cli, store):
    clusters.prepare(store, TOY, cluster(), submission(TOY))
    began = datetime.datetime.now(datetime.UTC) - datetime.timedelta(minutes=40)
    place = ("--store", str(store.root), "--pipeline", str(TOY.path))
    result = cli("record", "test", *place, "--since", began.strftime("%Y-%m-%dT%H:%M:%SZ"))
    assert result.returncode == 0, result.stderr
    for scene in submission(TOY).scenes:
        run = History(store).latest(scene.name)
        assert 2400 <= run.wall_s < 3000
        assert datetime.datetime.fromisoformat(run.started) == began.replace(microsecond=0)
        assert run.machine is None, "the recorder's says nothing of where the stages ran"
    published = cli("publish", "kitchen", "--store", str(store.root))
    assert published.returncode == 3, published.stderr
    report = cli.runs / "kitchen" / "report.html"
    assert "On a cluster, each stage on one of its machines." in report.read_text()


@pytest.mark.parametrize("since", ["yesterday", "2026-05-01T10:35:56", "{{workflow.creationTimestamp}}"])
def test_a_time_that_is_none_is_refused(cli, store, since):
    clusters.prepare(store, TOY, cluster(), submission(TOY))
    result = cli("record", "test", "--store", str(store.root), "--since", since)
    assert result.returncode == 2
    assert f"--since {since!r} is no time; give one with its zone" in result.stderr


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
    (template,) = [d for d in documents if d["kind"] == "WorkflowTemplate"]
    left_out = set(json.loads(template["metadata"]["annotations"][LEFT_OUT]))
    assert left_out == {"diffusion-training", "continued-reconstruction", "plate-export", "splat-export"} - (
        {"continued-reconstruction"} if flags else set()
    )
    submitted = clusters.load_submission(open_store(bucket), "spring")
    assert (submitted.compare, submitted.seed, submitted.preset) == (bool(flags), 3, "standard")
    wrong = cli("emit", "argo", str(capture), *files, "--set", "diffusion-training.steps=3")
    assert wrong.returncode == 2
    assert "diffusion-training is left out" in wrong.stderr


ITEM = f"t-0000.scene(0:capture:{DIGEST},mask-request:,name:n)"


def workflow(**nodes):
    """A Workflow as a controller leaves it: `scene` is the DAG of the scene n."""
    scene = {
        "name": ITEM, "type": "DAG", "templateName": "scene", "phase": "Running", "boundaryID": "top",
        "inputs": {"parameters": [{"name": "capture", "value": DIGEST}, {"name": "name", "value": "n"}]},
    }  # fmt: skip
    top = {"name": "t-0000", "type": "DAG", "templateName": "scenes", "phase": "Running"}
    said = {"phase": "Running", "nodes": {"top": top, "scene": scene, **nodes}}
    return {"metadata": {"name": "t-0000", "resourceVersion": "7"}, "status": said}


def pod(stage, phase, start, end=None, message="", attempt=0):
    return {
        "name": f"{ITEM}.{stage}({attempt})", "type": "Pod", "templateName": stage, "boundaryID": "scene",
        "phase": phase, "message": message, "startedAt": f"2026-01-01T10:{start:02}:00Z",
        "finishedAt": end and f"2026-01-01T10:{end:02}:00Z",
    }  # fmt: skip


WAIT = {
    "name": f"{ITEM}.await-mask", "type": "Suspend", "templateName": "await-mask", "phase": "Running",
    "boundaryID": "scene", "startedAt": "2026-01-01T10:00:00Z",
    "outputs": {"parameters": [{"name": "mask-request", "valueFrom": {"supplied": {}}}]},
}  # fmt: skip


def configured(tmp_path, **spec):
    (tmp_path / "cluster.yaml").write_text(cluster(**spec).model_dump_json(by_alias=True))
    return ("--cluster", str(tmp_path / "cluster.yaml"))


@pytest.mark.parametrize(
    ("nodes", "code", "says"),
    [
        ({"a": pod("ingest", "Succeeded", 0, 2)}, 0, r"n +ingest +Succeeded +120 +1"),
        (
            {"a": pod("ingest", "Error", 0, 1), "b": pod("ingest", "Succeeded", 2, 3, attempt=1)},
            0,
            r"ingest +Succeeded +60 +2",
        ),
        (
            {"a": pod("a", "Failed", 0, 1, "Error (exit code 3): bad input: frame_03.png is cut short")},
            3,
            r"a +Failed +60 +1 +Error \(exit code 3\): bad input: frame_03.png",
        ),
        ({"w": WAIT}, 4, r"n +await-mask +Running"),
        ({"a": pod("a", "Pending", 0, message="ImagePullBackOff: Back-off pulling image")}, 4, r"a +NoImage"),
    ],
)
def test_status_says_where_each_stage_of_each_scene_is(cli, kubectl, tmp_path, nodes, code, says):
    (kubectl / "answer").write_text(json.dumps({"items": [workflow(**nodes)]}))
    cli.extra = {"COLUMNS": "100"}
    result = cli("status", "test", *configured(tmp_path))
    assert result.returncode == code, result.stderr
    assert re.search(says, result.stdout), result.stdout
    assert max(map(len, result.stdout.splitlines())) <= 100
    assert result.stdout.endswith("t-0000: Running\n")


def test_status_is_repeated_until_all_is_over(kubectl, tmp_path, monkeypatch, capsys):
    running, over = workflow(a=pod("ingest", "Running", 0)), workflow(a=pod("ingest", "Succeeded", 0, 2))
    over["status"]["phase"] = "Succeeded"
    (kubectl / "answer").write_text(json.dumps({"items": [running]}))
    # Its work is done while the command waits.
    monkeypatch.setattr(time, "sleep", lambda _: (kubectl / "answer").write_text(json.dumps({"items": [over]})))
    _, path = configured(tmp_path)
    status("test", cluster=Path(path), watch=True)
    assert re.findall(r"t-0000: (\w+)", capsys.readouterr().out) == ["Running", "Succeeded"]


def test_status_of_what_is_not_there_is_an_error(kubectl):
    (kubectl / "answer").write_text('{"items": []}')
    with pytest.raises(ConfigurationError, match="no Workflow of test"):
        clusters.list_workflows(cluster(), "test")


def test_nodes_that_are_in_a_database_are_said_to_be():
    said = {"metadata": {"name": "t-0000"}, "status": {"offloadNodeStatusVersion": "fnv:1"}}
    with pytest.raises(ConfigurationError, match="keeps its nodes in a database"):
        list(list_rows(said, datetime.datetime.now(datetime.UTC)))


def test_logs_pass_over_pods_that_have_not_begun(kubectl):
    states = {"one": {"terminated": {}}, "two": {"waiting": {"reason": "ImagePullBackOff"}}, "three": None}
    pods = [
        {
            "metadata": {"name": name},
            "status": {"phase": "Pending", "containerStatuses": [{"name": "main", "state": state}] if state else []},
        }
        for name, state in states.items()
    ]
    (kubectl / "answer.get").write_text(json.dumps({"items": pods}))
    (kubectl / "answer.logs").write_text("said\nmore\n")
    assert list(clusters.logs(cluster(), "test", "a")) == [
        "[one] said\n",
        "[one] more\n",
        "[two] has printed nothing yet: ImagePullBackOff\n",
        "[three] has printed nothing yet: Pending\n",
    ]
    assert "inpaint3d/template=test,inpaint3d/node=a" in calls(kubectl)[0][0]


def test_logs_of_the_other_pods_are_told_where_one_has_none_any_more(kubectl):
    running = [{"name": "main", "state": {"running": {}}}]
    pods = [{"metadata": {"name": n}, "status": {"containerStatuses": running}} for n in ("gone", "here")]
    (kubectl / "answer.get").write_text(json.dumps({"items": pods}))
    (kubectl / "answer").unlink()
    told = list(clusters.logs(cluster(), "test", None))
    assert [line.partition("]")[0] for line in told] == ["[gone", "[here"]
    assert all("has no log" in line and "the server is out" in line for line in told)


def test_a_mask_is_given_to_its_scene_alone(store, kubectl, tmp_path):
    clusters.prepare(store, TOY, cluster(), submission(TOY, awaitMasks=True))
    (tmp_path / "mask.yaml").write_text("mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}")
    (kubectl / "answer.get").write_text(json.dumps({"items": [workflow(w=WAIT)]}))
    assert clusters.give(store, cluster(), "test", "n", MASK_REQUEST, tmp_path / "mask.yaml") == "t-0000"
    line, _ = calls(kubectl)[-1]
    assert line[2:5] == ["patch", "workflows.argoproj.io", "t-0000"]
    patch = json.loads(line[-1])
    assert patch["metadata"] == {"resourceVersion": "7"}
    (change,) = patch["status"]["nodes"].items()
    digest = clusters.load_submission(store, "test").scenes[1].externals["mask-request"]
    assert (change[0], change[1]["phase"]) == ("w", "Succeeded")
    assert change[1]["outputs"]["parameters"] == [
        {"name": "mask-request", "value": digest, "valueFrom": {"supplied": {}}}
    ]
    with pytest.raises(ConfigurationError, match="nothing of kitchen waits for its mask-request"):
        clusters.give(store, cluster(), "test", "kitchen", MASK_REQUEST, tmp_path / "mask.yaml")
    with pytest.raises(ConfigurationError, match="test has no scene hall; it has kitchen, n"):
        clusters.give(store, cluster(), "test", "hall", MASK_REQUEST, tmp_path / "mask.yaml")


def test_publish_of_a_scene_that_failed_says_so_with_its_code(cli, store):
    clusters.prepare(store, TOY, cluster(), submission(TOY))
    clusters.record(store, TOY, submission(TOY))
    result = cli("publish", "kitchen", "--store", str(store.root))
    assert result.returncode == 3, result.stderr
    assert "kitchen: failed; results:" in result.stderr


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
    (kubectl / "answer").write_text("")
    (name,) = clusters.rerun(store, TOY, where, "test", "ingest", ["n"])
    assert store.lookup(keys["n"]) is None
    documents = [d for _, text in calls(kubectl) for d in yaml.safe_load_all(text) if d]
    workflow = documents[-1]
    assert workflow["metadata"]["name"] == name != "test-0000"
    assert [s["name"] for s in json.loads(workflow["spec"]["arguments"]["parameters"][0]["value"])] == ["n"]
    assert check(documents, TOY) == []
    with pytest.raises(ConfigurationError, match="test has no scene hall; it has kitchen, n"):
        clusters.rerun(store, TOY, where, "test", "ingest", ["hall"])
    with pytest.raises(ConfigurationError, match="nothing was submitted as tset; there are test"):
        clusters.rerun(store, TOY, where, "tset", "ingest", [])


def test_a_rerun_waits_for_no_mask_that_was_supplied(store, kubectl, tmp_path):
    clusters.prepare(store, TOY, cluster(), submission(TOY, awaitMasks=True))
    (tmp_path / "mask.yaml").write_text("mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}")
    digest = clusters.supply(store, "test", "n", MASK_REQUEST, tmp_path / "mask.yaml")
    scenes = {s.name: s.externals for s in clusters.load_submission(store, "test").scenes}
    assert scenes == {"kitchen": {"capture": DIGEST}, "n": {"capture": DIGEST, "mask-request": digest}}
    waits = []
    (kubectl / "answer").write_text("")
    for chosen in (["n"], ["kitchen"]):
        clusters.rerun(store, TOY, cluster(), "test", "ingest", chosen)
        *_, template = yaml.safe_load_all(calls(kubectl)[-2][1])
        waits.append("await-mask" in {t["name"] for t in template["spec"]["templates"]})
    assert waits == [False, True]


def test_a_cluster_that_does_not_answer_is_said_in_its_words(kubectl):
    (kubectl / "answer").unlink()
    with pytest.raises(ConfigurationError, match="the server is out"):
        list(clusters.logs(cluster(), "test", None))


def test_kubectl_that_is_not_there_is_asked_for(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ConfigurationError, match="kubectl is not on the PATH"):
        list(clusters.logs(cluster(), "test", None))
