from xml.etree import ElementTree

import pytest

from inpaint3d.report.charts import HEIGHT, LEFT, MAX_MARKED_POINTS, WIDTH, Axis, Line, choose_step, line_chart


def read_svg(chart):
    return ElementTree.fromstring(chart[chart.index("<svg") :])  # noqa: S314 - our own


def read_curves(chart):
    lines = read_svg(chart).findall("polyline")
    return [[tuple(map(float, p.split(","))) for p in line.get("points", "").split()] for line in lines]


def test_a_chart_of_nothing_is_nothing():
    assert line_chart([], "x", "y") == ""
    assert line_chart([Line("a", [])], "x", "y") == ""


def test_a_single_point_is_drawn():
    svg = read_svg(line_chart([Line("a", [(5, 1.0)])], "x", "y"))
    (circle,) = svg.findall("circle")
    assert LEFT < float(circle.get("cx", "")) < WIDTH
    assert 0 < float(circle.get("cy", "")) < HEIGHT


@pytest.mark.parametrize("scale", [1e-6, 1e-2, 1.0, 1e5])
def test_a_curve_fills_the_drawing_whatever_its_scale(scale):
    ((first, last),) = read_curves(line_chart([Line("a", [(0.0, 2 * scale), (10.0, 3 * scale)])], "x", "y"))
    assert first[0] == LEFT
    assert last[0] == WIDTH - 16
    assert first[1] - last[1] > 0.8 * (HEIGHT - 14 - 40)  # up is less in SVG


def test_a_small_change_looks_small_where_a_span_is_asked_for():
    ((first, last),) = read_curves(line_chart([Line("a", [(0, 20.0), (1, 20.01)])], "x", "y", min_y_span=0.5))
    assert 0 < first[1] - last[1] < 0.05 * HEIGHT


def test_points_of_a_long_series_are_not_marked():
    few, many = ([Line("a", [(i, float(i)) for i in range(n)])] for n in (MAX_MARKED_POINTS, MAX_MARKED_POINTS + 1))
    assert len(read_svg(line_chart(few, "x", "y")).findall("circle")) == MAX_MARKED_POINTS
    assert not read_svg(line_chart(many, "x", "y")).findall("circle")


@pytest.mark.parametrize(
    ("low", "high", "step"), [(0, 5, 1), (0, 5.1, 2), (0, 1600, 500), (20.1, 27.3, 2), (0, 3e-3, 1e-3), (-1, 1, 0.5)]
)
def test_steps_are_round(low, high, step):
    assert choose_step(low, high) == pytest.approx(step)


def test_ticks_lie_at_their_values():
    ticks = Axis(0.0, 1.0, 100.0, 200.0).label_ticks()
    assert [text for _, text in ticks] == ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]
    assert [place for place, _ in ticks] == pytest.approx([100, 120, 140, 160, 180, 200])


def test_names_are_escaped():
    chart = line_chart([Line("<b>", [(0, 1.0), (1, 2.0)])], "<x>", '"y"')
    assert "&lt;b&gt;" in chart
    assert "<x>" not in chart
    assert read_svg(chart).get("aria-label") == '"y" against <x>'
