from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.models.stage import Tolerance
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.comparison import compare
from inpaint3d.orchestrator.plan import find_pipeline

PIPELINE = Pipeline(find_pipeline(None))
NODE = PIPELINE.order[0]


def source(store, text):
    folder = store.private_folder()
    (folder / "a.txt").write_text(text)
    (folder / "b.txt").write_text("the same")
    return store.put(folder, "source", Source(name="x", kind="folder"))


def run(digest, seed=0):
    components = {"parameters": {}, "inputs": {}, "seed": seed, "code": digest}
    node = NodeRun(node=NODE, status="done", reason="", components=components, outputs={"capture": digest})
    machine = Machine(processor="", cores=1, memory_bytes=0, python="")
    return RunRecord(
        id="1", name="x", pipeline="", preset=None, externals={}, status="done", started="", machine=machine,
        nodes=(node,),
    )  # fmt: skip


def test_files_that_differ_are_named(tmp_path):
    one, two = FolderStore(tmp_path / "one"), FolderStore(tmp_path / "two")
    a, b = source(one, "a"), source(two, "b")
    (row,) = compare(PIPELINE, one, run(a), two, run(b))
    assert (row.verdict, row.detail) == ("differs", "1 of 2 files: a.txt")
    (row,) = compare(PIPELINE, one, run(a), two, run(a))
    assert (row.verdict, row.port) == ("equal", "capture")
    (row,) = compare(PIPELINE, one, run(a), two, run(a, seed=1))
    assert (row.verdict, row.detail) == ("was asked something else", "seed")


def test_what_a_stage_declares_may_differ(tmp_path, monkeypatch):
    store = FolderStore(tmp_path)
    a, b = source(store, "a"), source(store, "b")
    stage = PIPELINE.stages[NODE]
    loose = stage.spec.model_copy(update={"determinism": Tolerance(tolerance="the last bit")})
    monkeypatch.setitem(PIPELINE.stages, NODE, stage.model_copy(update={"spec": loose}))
    (row,) = compare(PIPELINE, store, run(a), store, run(b))
    assert (row.verdict, row.detail) == ("may differ", "the last bit")
