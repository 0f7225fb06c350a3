"""Saturating curves without an array library: where they bend, and what more time would buy."""

import random
from collections.abc import Sequence
from dataclasses import dataclass

Points = Sequence[tuple[float, float]]
"""(cost, gain), cost increasing."""

LEAST_POINTS = 5
EXPONENTS = tuple(0.1 * 1.2**i for i in range(20))  # 0.1 to 3.2
RESAMPLES = 200


@dataclass(frozen=True)
class Gain:
    """What more time would buy, and where 95 % of the refits lie."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class PowerLaw:
    """y = limit - scale * x^-exponent."""

    limit: float
    scale: float
    exponent: float

    def at(self, x: float) -> float:
        return self.limit - self.scale * x**-self.exponent


def find_knee(points: Points) -> int | None:
    """Index of the point farthest above the chord from the first to the last (Kneedle, Satopaa et al. 2011).

    None where there are fewer than three points, or none lies above it: the curve has no bend.
    """
    (x0, y0), (x1, y1) = points[0], points[-1]
    if len(points) < 3 or x1 <= x0 or y1 <= y0:
        return None
    above = [(y - y0) / (y1 - y0) - (x - x0) / (x1 - x0) for x, y in points]
    best = max(range(len(points)), key=above.__getitem__)
    return best if above[best] > 0 else None


def fit_power_law(points: Points) -> PowerLaw:
    """Least squares over x > 0: linear in limit and scale, the exponent by search; two different x at least."""
    fits = [_fit_line([(x**-c, y) for x, y in points], c) for c in EXPONENTS]
    return min(fits, key=lambda fit: sum((fit.at(x) - y) ** 2 for x, y in points))


def _fit_line(points: Points, exponent: float) -> PowerLaw:
    n = len(points)
    mean_u, mean_y = sum(u for u, _ in points) / n, sum(y for _, y in points) / n
    spread = sum((u - mean_u) ** 2 for u, _ in points)
    slope = sum((u - mean_u) * (y - mean_y) for u, y in points) / spread if spread > 0 else 0.0
    return PowerLaw(limit=mean_y - slope * mean_u, scale=-slope, exponent=exponent)


def forecast_gain(points: Points, ahead: float) -> Gain | None:
    """What a curve would gain over its last fitted value when it went on for `ahead`; None below five points.

    The interval is the bootstrap's: the residuals are drawn anew and the law is fitted again. It knows of noise alone,
    not of a law that does not hold.
    """
    known = [(x, y) for x, y in points if x > 0]
    if len(known) < LEAST_POINTS or ahead <= 0:
        return None
    end = known[-1][0]

    def gain(fit: PowerLaw) -> float:
        return fit.at(end + ahead) - fit.at(end)

    law = fit_power_law(known)
    residuals = [y - law.at(x) for x, y in known]
    draw = random.Random(0)  # noqa: S311 - the same interval every time
    refits = sorted(
        gain(fit_power_law([(x, law.at(x) + draw.choice(residuals)) for x, _ in known])) for _ in range(RESAMPLES)
    )
    tail = round(0.025 * RESAMPLES)
    value = gain(law)
    return Gain(value, min(value, refits[tail]), max(value, refits[-1 - tail]))
