"""The emitted manifests do what the pipeline says: executed with processes for pods, against a bucket."""

import datetime
import os

import pytest

from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.cluster import Scene
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store.bucket import BucketStore
from inpaint3d.orchestrator.cluster import prepare, supply
from inpaint3d.orchestrator.configure import configure_submission
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.intake import MASK_REQUEST
from inpaint3d.orchestrator.workflows import list_rows, supply_patch
from tests.conftest import REPOSITORY
from tests.kubernetes.manifests import cluster, submission
from tests.kubernetes.simulator import PAST_DEADLINE, Argo, StageFailedError

NOW = datetime.datetime.now(datetime.UTC)
MASK = "mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}"


@pytest.fixture
def store(bucket, tmp_path):
    return BucketStore(bucket, tmp_path / "cache")


def capture(store, text):
    folder = store.private_folder()
    (folder / "raw").mkdir()
    (folder / "raw" / "note.txt").write_text(text)
    return store.put(folder, "source", Source(name=text, kind="folder"))


def environment_of(pipeline):
    """What each image sets itself: where its stage.yaml lies."""
    files = {
        stage.spec.image: str(pipeline.path.parent / pipeline.nodes[node].stage / "stage.yaml")
        for node, stage in pipeline.stages.items()
    }

    def environment(image):
        name = image.removeprefix("registry.example/").removesuffix(":1")
        file = files.get(name)
        return {} if file is None else {"INPAINT3D_STAGE_YAML": file}

    return environment


def started(store, pipeline, tmp_path, **options):
    asked = submission(pipeline, **{"stub": True, **options})
    where = cluster(endpoint=os.environ["AWS_ENDPOINT_URL"]).model_copy()
    where = where.model_copy(update={"spec": where.spec.model_copy(update={"store": store.place})})
    *documents, workflow = prepare(store, pipeline, where, asked, replace=True)
    return Argo(documents, tmp_path / "pods", environment_of(pipeline)), workflow


@pytest.mark.parametrize("compress_from", [400, 1])
def test_a_scene_runs_through_a_lost_pod_and_a_person(store, tmp_path, compress_from):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    scene = Scene(name="kitchen", externals={"capture": capture(store, "kitchen")})
    configured = configure_submission(pipeline, submission(pipeline, scenes=(scene,), awaitMasks=True))
    order = configured.pipeline.order
    argo, workflow = started(store, pipeline, tmp_path, scenes=(scene,), awaitMasks=True)
    (tmp_path / "mask.yaml").write_text(MASK)
    asked = []

    def person(argo, where):
        asked.append(where)
        digest = supply(store, "test", "kitchen", MASK_REQUEST, tmp_path / "mask.yaml")
        assert supply_patch(argo.workflow, "hall", MASK_REQUEST, digest, NOW) is None, "another scene's"
        argo.patch(supply_patch(argo.workflow, "kitchen", MASK_REQUEST, digest, NOW))
        assert supply_patch(argo.workflow, "kitchen", MASK_REQUEST, digest, NOW) is None, "it waits no more"

    argo.supply, argo.compress_from = person, compress_from
    argo.loses = lambda where, attempt: where.endswith(".nerf-pretraining") and attempt == 0
    assert argo.run(workflow) == "Succeeded", [p for p in argo.pods if p.phase != "Succeeded"]
    assert len(asked) == 1
    pods = [(p.where.rpartition(".")[2], p.phase) for p in argo.pods]
    assert ("nerf-pretraining", "Error") in pods
    assert sorted(n for n, phase in pods if phase == "Succeeded") == sorted([*order, "onExit"])
    assert len(list(store.records())) == len(order)
    run = History(store).latest("kitchen")
    assert run.status == "done"
    assert {n.node for n in run.nodes if n.outputs} == set(order)
    assert {n.node: n.reason for n in run.nodes if n.status == "left-out"} == configured.left_out != {}
    rows = {row.stage: row for row in list_rows(argo.workflow, NOW)}
    assert set(rows) == {*order, "await-mask", "record"}
    assert {row.scene for row in rows.values()} == {"kitchen", ""}
    assert (rows["nerf-pretraining"].phase, rows["nerf-pretraining"].tries) == ("Succeeded", 2)
    assert rows["usd-export"].seconds >= 0


def test_scenes_fan_out_and_one_that_fails_stops_no_other(store, tmp_path):
    for name in ("schemas", "stages"):
        (tmp_path / name).symlink_to(REPOSITORY / name)
    text = (REPOSITORY / "pipeline.yaml").read_text()
    # Pods find it, as they do in the image: it is the nearest one above their working folder.
    (tmp_path / "pipeline.yaml").write_text(text[: text.index("    - name: scene-analysis")])
    pipeline = Pipeline(tmp_path / "pipeline.yaml")
    assert pipeline.order == ["capture-ingest", "pose-estimation"]
    good = Scene(name="good", externals={"capture": capture(store, "good")})
    bad = Scene(name="n", externals={"capture": capture(store, "n")})
    argo, workflow = started(store, pipeline, tmp_path, scenes=(bad, good), preset=None)
    argo.loses = lambda where, attempt: ",name:n," in where and where.endswith(".capture-ingest")
    assert argo.run(workflow) == "Failed"
    lost = [p.where for p in argo.pods if p.phase != "Succeeded"]
    assert len(lost) == 4, "one try, three more, and nothing behind it"
    item = {"name": "n", **dict.fromkeys(pipeline.spec.spec.externals, ""), **bad.externals}
    said = ",".join(f"{key}:{item[key]}" for key in sorted(item))
    assert set(lost) == {f"test-0000.scene(0:{said}).capture-ingest"}, "as the real one names them"
    assert History(store).latest("good").status == "done"
    assert {n.node: n.status for n in History(store).latest("n").nodes} == {
        "capture-ingest": "pending", "pose-estimation": "pending",
    }  # fmt: skip
    before = {r.key for r in store.records()}
    again, workflow = started(store, pipeline, tmp_path / "again", scenes=(good,), preset=None)
    assert again.run(workflow) == "Succeeded"
    assert {r.key for r in store.records()} == before


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda d: d.pop(0) and d.pop(0), "may not report to Argo"),
        (lambda d: d[-1]["spec"].pop("podSpecPatch"), "init: runAsNonRoot is not True"),
        (
            lambda d: d[-1]["spec"].update(podSpecPatch=d[-1]["spec"]["podSpecPatch"].replace("limits", "x")),
            "quota asks",
        ),
    ],
)
def test_a_strict_namespace_lets_no_pod_in_that_is_not_as_emitted(store, tmp_path, change, says):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    scene = Scene(name="kitchen", externals={"capture": capture(store, "kitchen")})
    argo, workflow = started(store, pipeline, tmp_path, scenes=(scene,))
    change(argo.documents)
    with pytest.raises(StageFailedError):  # the exit handler's pod is refused as well
        argo.run(workflow)
    assert says in argo.pods[0].message
    assert {pod.phase for pod in argo.pods} == {"Error"}


def test_a_failed_pod_says_why(store, tmp_path):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    scene = Scene(name="kitchen", externals={"capture": "sha256:" + "0" * 64})
    argo, workflow = started(store, pipeline, tmp_path, scenes=(scene,), stub=False)
    assert argo.run(workflow) == "Failed"
    (row,) = [row for row in list_rows(argo.workflow, NOW) if row.stage == "capture-ingest"]
    assert row.phase == "Failed"
    assert "Error (exit code 3): bad artifact: artifact sha256:000" in row.message


def test_an_image_that_cannot_be_pulled_is_waited_for_until_the_deadline_and_noticed_meanwhile(store, tmp_path):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    scene = Scene(name="kitchen", externals={"capture": capture(store, "kitchen")})
    argo, workflow = started(store, pipeline, tmp_path, scenes=(scene,))
    argo.lacks = lambda image: "capture-ingest" in image
    seen = []
    argo.look = lambda argo: seen.extend((row.stage, row.phase) for row in list_rows(argo.workflow, NOW))
    assert argo.run(workflow) == "Failed"
    assert seen == [("capture-ingest", "NoImage")], "once: it is not tried again"
    phases = {row.stage: (row.phase, row.tries, row.message) for row in list_rows(argo.workflow, NOW)}
    assert phases["capture-ingest"] == ("Failed", 1, PAST_DEADLINE)
    assert History(store).latest("kitchen").status == "failed"
