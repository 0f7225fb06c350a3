"""A line chart as inline SVG: learning curves, without a plotting library."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

COLOURS = ("#0b6e8f", "#c8553d", "#5b8e7d", "#8d5a97", "#b88a12")
_W, _H = 640, 260
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 16, 14, 40


@dataclass(frozen=True)
class Line:
    """One named curve: (x, y) points in order of x."""

    name: str
    points: Sequence[tuple[float, float]]


def line_chart(lines: Sequence[Line], x_title: str, y_title: str) -> str:
    """An <svg> with axes, a grid and one polyline for each curve that has points; empty where none has."""
    lines = [line for line in lines if line.points]
    if not lines:
        return ""
    xs = [x for line in lines for x, _ in line.points]
    ys = [y for line in lines for _, y in line.points]
    x_low, x_high = min(0.0, min(xs)), max(*xs, min(xs) + 1e-9) if len(xs) > 1 else max(xs[0], 1.0)
    y_low, y_high = min(ys), max(ys)
    margin = max(0.08 * (y_high - y_low), 0.25)
    y_low, y_high = y_low - margin, y_high + margin

    def at(x: float, y: float) -> tuple[float, float]:
        u = (x - x_low) / max(x_high - x_low, 1e-9)
        v = (y - y_low) / (y_high - y_low)
        return _LEFT + u * (_W - _LEFT - _RIGHT), _H - _BOTTOM - v * (_H - _TOP - _BOTTOM)

    parts = [f'<svg viewBox="0 0 {_W} {_H}" role="img" class="chart" aria-label="{escape(y_title)}">']
    for i in range(5):
        x, y = x_low + i * (x_high - x_low) / 4, y_low + i * (y_high - y_low) / 4
        (px, _), (_, py) = at(x, y_low), at(x_low, y)
        parts.append(f'<line x1="{_LEFT}" x2="{_W - _RIGHT}" y1="{py:.1f}" y2="{py:.1f}" class="grid"/>')
        parts.append(f'<text x="{_LEFT - 6}" y="{py + 4:.1f}" text-anchor="end">{y:.1f}</text>')
        parts.append(f'<text x="{px:.1f}" y="{_H - _BOTTOM + 16}" text-anchor="middle">{x:.0f}</text>')
    parts.append(f'<text x="{(_LEFT + _W) / 2}" y="{_H - 6}" text-anchor="middle">{escape(x_title)}</text>')
    for i, line in enumerate(lines):
        colour = COLOURS[i % len(COLOURS)]
        coordinates = " ".join(f"{px:.1f},{py:.1f}" for px, py in (at(*p) for p in line.points))
        parts.append(f'<polyline points="{coordinates}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [
            f'<circle cx="{px:.1f}" cy="{py:.1f}" r="2.6" fill="{colour}"/>' for px, py in (at(*p) for p in line.points)
        ]
    parts.append("</svg>")
    legend = "".join(
        f'<span><i style="background:{COLOURS[i % len(COLOURS)]}"></i>{escape(line.name)}</span>'
        for i, line in enumerate(lines)
    )
    return f'<div class="legend">{legend}</div>' + "".join(parts)
