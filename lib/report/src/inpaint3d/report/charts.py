"""A line chart as inline SVG, without a plotting library."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle

from inpaint3d.report.page import render

COLOURS = tuple(f"var(--line-{i})" for i in range(1, 6))  # of the page, light and dark
WIDTH, HEIGHT = 640, 260
LEFT, RIGHT, TOP, BOTTOM = 52, 16, 14, 40
MAX_MARKED_POINTS = 60


@dataclass(frozen=True)
class Line:
    """One named curve: (x, y) points in order of x."""

    name: str
    points: Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Axis:
    """A range of values and where it lies in the drawing, both from its low end to its high end."""

    low: float
    high: float
    start: float
    end: float

    def place(self, value: float) -> float:
        return self.start + (value - self.low) / (self.high - self.low) * (self.end - self.start)

    def label_ticks(self) -> list[tuple[float, str]]:
        """(place, text) of about five round values."""
        step = choose_step(self.low, self.high)
        decimals = max(0, -math.floor(math.log10(step)))
        count = range(math.ceil(self.low / step), math.floor(self.high / step) + 1)
        return [(self.place(i * step), f"{i * step:.{decimals}f}") for i in count]


def choose_step(low: float, high: float) -> float:
    """1, 2 or 5 times a power of ten: the smallest that cuts [low, high] into at most five intervals; high > low."""
    least = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(least))
    # Rounding may leave `least` a hair above ten times the power below it.
    return next((m * power for m in (1, 2, 5) if m * power >= least), 10 * power)


def line_chart(lines: Sequence[Line], x_title: str, y_title: str, min_y_span: float = 0.0) -> str:
    """A legend and an <svg> with axes, a grid and a polyline for each curve that has points; "" where none has.

    x begins at 0 or below. y shows at least `min_y_span`, so that noise of a smaller size does not look like a curve.
    """
    lines = [line for line in lines if line.points]
    x = _make_x_axis([x for line in lines for x, _ in line.points])
    y = _make_y_axis([y for line in lines for _, y in line.points], min_y_span)
    return render(
        "inpaint3d.report",
        "chart.html.j2",
        curves=[
            {"name": line.name, "colour": colour, "points": [(x.place(u), y.place(v)) for u, v in line.points]}
            for line, colour in zip(lines, cycle(COLOURS), strict=False)
        ],
        x=x, y=y, x_title=x_title, y_title=y_title, width=WIDTH, height=HEIGHT, max_marked_points=MAX_MARKED_POINTS,
    )  # fmt: skip


def _make_x_axis(values: Sequence[float]) -> Axis:
    low, high = min(0.0, *values, 0.0), max(values, default=1.0)
    return Axis(low, high if high > low else low + 1.0, LEFT, WIDTH - RIGHT)


def _make_y_axis(values: Sequence[float], min_span: float) -> Axis:
    low, high = min(values, default=0.0), max(values, default=1.0)
    margin = max(0.08 * (high - low), (min_span - (high - low)) / 2)
    if margin <= 0:  # one value: any range around it will do
        margin = abs(low) / 2 or 1.0
    return Axis(low - margin, high + margin, HEIGHT - BOTTOM, TOP)
