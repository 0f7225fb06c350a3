from html.parser import HTMLParser

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import Protocol
from inpaint3d.report.page import DOUBT_MARKER, RUN_MARKER
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.evaluation.report import Curve, Report, Strip, cost_of_stopping_early, write_report
from inpaint3d.stages.evaluation.scores import metric


def page(tmp_path, **changes) -> str:
    write_png(tmp_path / "a.png", np.zeros((4, 8, 3), np.float32))
    strip = Strip("view <1>", tmp_path / "a.png", ("before", "after"))
    values = {
        "title": "T",
        "hole": "H",
        "protocols": [
            Protocol(name="p", description="d", metrics=(metric("a", "psnr", 1.234, 2), metric("b", "psnr", 2, 2)))
        ],
        "contact": strip,
        "strips": [strip],
        "curves": [Curve("a", [(1.0, 10.0), (2.0, 12.0)])],
        "notes": ["n"],
        "non_finite": {},
    } | changes
    write_report(tmp_path / "report.html", Report(**values))
    return (tmp_path / "report.html").read_text()


def test_the_page_stands_alone(tmp_path):
    class Links(HTMLParser):
        found: list[str] = []

        def handle_starttag(self, tag, attrs):
            self.found += [v for k, v in attrs if k in ("src", "href") and v]

    parser = Links()
    parser.feed(page(tmp_path))
    assert parser.found
    assert all(link.startswith("data:image/png;base64,") for link in parser.found)


def test_lines_are_left_for_the_run_its_doubts_before_all_else(tmp_path):
    lines = page(tmp_path).splitlines()
    assert [lines.count(marker) for marker in (DOUBT_MARKER, RUN_MARKER)] == [1, 1]
    assert lines.index(DOUBT_MARKER) < min(i for i, line in enumerate(lines) if "<h1>" in line)


def test_the_best_figure_is_marked_and_names_are_escaped(tmp_path):
    text = page(tmp_path)
    assert '<td class="best">2.00</td>' in text
    assert "<td>1.23</td>" in text
    assert "view &lt;1&gt;" in text


def test_the_health_of_each_fit_is_told(tmp_path):
    shown = page(tmp_path, health={"joint": {"gradient_norm_largest": 0.0123, "rollbacks": 1.0}})
    assert "gradient norm largest 0.0123; rollbacks 1" in shown
    assert "Health of the fits" not in page(tmp_path)


def test_non_finite_values_are_told(tmp_path):
    assert "joint/view_3: 7" in page(tmp_path, non_finite={"joint/view_3": 7})
    assert "Non-finite" not in page(tmp_path)


def test_stopping_early_costs_what_the_curve_says():
    row = cost_of_stopping_early(Curve("a", [(100, 10.0), (200, 14.0), (300, 15.0), (400, 15.5)]))
    assert row is not None
    label, costs, last = row
    assert (label, last) == ("a", 15.5)
    assert costs == pytest.approx([-5.5, -1.5, -0.5])
    assert cost_of_stopping_early(Curve("a", [(100, 10.0)])) is None
