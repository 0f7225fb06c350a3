from xml.etree import ElementTree

import pytest

from inpaint3d.contracts.models.report import NodeRun
from inpaint3d.orchestrator.pages.dag import draw_dag, format_seconds


def node(name: str, *after: str, status: str = "done") -> NodeRun:
    return NodeRun.model_validate({"node": name, "status": status, "reason": "", "after": after, "wall_s": 2.0})


def test_what_is_read_lies_above_and_what_follows_is_not_drawn():
    nodes = [node("a"), node("b", "a"), node("c", "a", "b"), node("d", "b"), node("e", status="left-out")]
    svg = ElementTree.fromstring(draw_dag(nodes))  # noqa: S314 - our own
    tops = {g.findall("text")[0].text: float(g.find("rect").get("y")) for g in svg.findall("g")}
    assert set(tops) == {"a", "b", "c", "d"}
    assert tops["a"] < tops["b"] < tops["c"] == tops["d"]
    assert len(svg.findall("path")) == 3  # a-b, b-c, b-d; a-c follows


def test_a_record_that_does_not_say_what_reads_what_is_not_drawn():
    assert draw_dag([node("a"), node("b")]) == ""


@pytest.mark.parametrize(
    ("seconds", "text"), [(0.44, "0.4 s"), (58.2, "58 s"), (140.3, "2 min 20 s"), (3599.7, "1 h 00 min")]
)
def test_times_are_told_as_people_say_them(seconds, text):
    assert format_seconds(seconds) == text
