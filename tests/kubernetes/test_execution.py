"""The emitted manifests do what the pipeline says: executed with processes for pods, against a bucket."""

import os

import pytest

from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.cluster import Scene
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store.bucket import BucketStore
from inpaint3d.orchestrator.cluster import prepare, supply_mask
from inpaint3d.orchestrator.configure import configure_submission
from inpaint3d.orchestrator.history import History
from tests.conftest import REPOSITORY
from tests.kubernetes.manifests import cluster, submission
from tests.kubernetes.simulator import Argo

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
    asked = submission(pipeline, stub=True, **options)
    where = cluster(endpoint=os.environ["AWS_ENDPOINT_URL"]).model_copy()
    where = where.model_copy(update={"spec": where.spec.model_copy(update={"store": store.place})})
    template, workflow = prepare(store, pipeline, where, asked)
    return Argo(template, tmp_path / "pods", environment_of(pipeline)), workflow


def test_a_scene_runs_through_a_lost_pod_and_a_person(store, tmp_path):
    pipeline = Pipeline(REPOSITORY / "pipeline.yaml").under(None)
    scene = Scene(name="kitchen", externals={"capture": capture(store, "kitchen")})
    configured = configure_submission(pipeline, submission(pipeline, scenes=(scene,), awaitMasks=True))
    order = configured.pipeline.order
    argo, workflow = started(store, pipeline, tmp_path, scenes=(scene,), awaitMasks=True)
    (tmp_path / "mask.yaml").write_text(MASK)
    asked = []

    def person(where):
        asked.append(where)
        return {"mask-request": supply_mask(store, "test", "kitchen", tmp_path / "mask.yaml")}

    argo.supply = person
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
    argo.loses = lambda where, attempt: "scene(0:n).capture-ingest" in where
    assert argo.run(workflow) == "Failed"
    lost = [p.where.split(".")[1:] for p in argo.pods if p.phase != "Succeeded"]
    assert lost == [["scene(0:n)", "capture-ingest"]] * 4, "one try, three more, and nothing behind it"
    assert History(store).latest("good").status == "done"
    assert {n.node: n.status for n in History(store).latest("n").nodes} == {
        "capture-ingest": "pending", "pose-estimation": "pending",
    }  # fmt: skip
    before = {r.key for r in store.records()}
    again, workflow = started(store, pipeline, tmp_path / "again", scenes=(good,), preset=None)
    assert again.run(workflow) == "Succeeded"
    assert {r.key for r in store.records()} == before
