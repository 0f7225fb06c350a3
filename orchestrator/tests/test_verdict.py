import pytest

from inpaint3d.contracts.models.artifacts import Evaluation, Metric, Protocol
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.orchestrator.pages.verdict import KNOWN, TRUTH, judge

MACHINE = Machine(processor="P", cores=2, memory_bytes=2**33, python="3.12")


def record(status: str, *nodes: NodeRun, **values) -> RunRecord:
    return RunRecord.model_validate(
        {"id": "i", "name": "n", "pipeline": "p", "preset": None, "externals": {}, "status": status, "started": ""}
        | {"machine": MACHINE, "nodes": nodes} | values
    )  # fmt: skip


def protocol(name: str, psnr: float, lpips: float) -> Protocol:
    values = {"psnr": psnr, "lpips_vgg": lpips}
    metrics = [
        Metric(method=m, name=n, value=v, unit="1", better="", views=20)
        for m in ("ours", "plain")
        for n, v in values.items()
    ]
    return Protocol(name=name, description="", metrics=tuple(metrics))


def test_a_good_run_says_how_near_the_truth_it_is():
    found = judge(record("done"), Evaluation(protocols=(protocol(TRUTH, 22.61, 0.24), protocol(KNOWN, 28.0, 0.1))))
    assert found.tone == "good"
    assert "22.6 dB PSNR (LPIPS 0.24) from what is really there, over 20 views" in found.sentence
    assert "never saw at 28.0 dB" in found.sentence


def test_what_came_out_weak_is_a_warning():
    found = judge(record("done"), Evaluation(protocols=(), weaknesses=("Weak: fog remains.",)))
    assert (found.tone, found.points) == ("warn", ("fog remains.",))
    assert "nothing tells how truly" in found.sentence


def test_a_failure_says_where_what_and_how_to_go_on():
    bad = NodeRun(node="pose-estimation", status="failed", reason="", error="3 photos; take 20", exit_code=3)
    found = judge(record("failed", bad), None)
    assert found.tone == "bad"
    assert found.sentence == "The run failed at pose-estimation: 3 photos; take 20"
    assert found.points[0].startswith("pose-estimation: exit 3, ")
    assert "same command again" in found.points[-1]


@pytest.mark.parametrize(
    ("ended", "said"),
    [
        (record("stopped", error="its process was killed"), "The run was stopped: its process was killed."),
        (record("failed", NodeRun(node="b", status="pending", reason="after a")), "nothing made what b needs"),
        (record("running"), "going on"),
    ],
)
def test_a_run_that_no_stage_ended_says_so(ended, said):
    assert said in judge(ended, None).sentence
