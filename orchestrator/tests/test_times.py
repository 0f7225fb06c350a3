"""What stopping a fit earlier would have cost."""

from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import FolderStore, Record
from inpaint3d.orchestrator.times import render_times

COMPONENTS = {"seed": 1}
KEY = digest_of(COMPONENTS)
MACHINE = Machine(processor="P", cores=2, memory_bytes=2**33, python="3.12")


def page(tmp_path, series):
    store = FolderStore(tmp_path / "store")
    store.commit(
        Record(
            key=KEY,
            stage="s@1",
            components=COMPONENTS,
            outputs={},
            provenance={},
            timings={"series": {"curve": series}},
        )
    )
    node = NodeRun(node="train", status="done", reason="<new>", key=KEY, wall_s=40.0)
    record = RunRecord(
        id="i", name="n", pipeline="p", preset="draft", externals={}, status="done", started="", machine=MACHINE,
        nodes=(node,),
    )  # fmt: skip
    return render_times(store, record)


def test_stopping_earlier_is_told_against_the_end(tmp_path):
    steps = ((10, 20.0), (20, 24.0), (30, 25.0), (40, 25.5))
    html = page(tmp_path, [{"step": w, "psnr": p, "wall_s": w, "cpu_s": 2 * w} for w, p in steps])
    assert "<tr><td>50%</td><td>20</td><td>40</td><td>24</td><td>-1.5</td></tr>" in html
    assert "<tr><td>100%</td><td>40</td><td>80</td><td>25.5</td><td>+0</td></tr>" in html
    assert "stopped at" in html


def test_a_figure_that_was_measured_once_draws_no_curve(tmp_path):
    assert "stopped at" not in page(tmp_path, [{"psnr": 20.0, "wall_s": 1.0, "cpu_s": 1.0}])
