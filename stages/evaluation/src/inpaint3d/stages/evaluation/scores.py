"""Figures by protocol, method and view; their means are what the artifact states."""

import csv
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Metric

RESAMPLES = 2000
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Kind:
    """How a figure is written and read."""

    title: str
    unit: str
    better: str
    digits: int


KINDS: dict[str, Kind] = {
    "psnr": Kind("PSNR", "dB", "higher", 2),
    "ssim": Kind("SSIM", "1", "higher", 3),
    "lpips_vgg": Kind("LPIPS (VGG)", "1", "lower", 3),
    "lpips_alex": Kind("LPIPS (Alex)", "1", "lower", 3),
    "fd_lite0": Kind("FD-lite0", "1", "lower", 1),
    "kid_lite0": Kind("KID-lite0", "1", "lower", 4),
    "opacity_mean": Kind("opacity, mean", "1", "higher", 3),
    "opacity_min": Kind("opacity, least", "1", "higher", 3),
    "opaque_share": Kind("share of opacity ≥ 0.95", "1", "higher", 3),
    "gradient_share": Kind("gradient energy, hole : truth", "1", "nearer 1", 2),
    "depth_spread": Kind("spread of depth along rays : distance", "1", "lower", 3),
    "reprojection_hole": Kind("colour difference to the next view, hole", "1", "lower", 4),
    "reprojection_known": Kind("the same, known pixels", "1", "lower", 4),
    "depth_error": Kind("depth at sparse points, median relative error", "1", "lower", 4),
    "floaters": Kind("opacity in front of sparse points", "1", "lower", 4),
    "lpips_between": Kind("LPIPS (VGG) between them", "1", "higher", 3),
    "colour_between": Kind("colour difference between them, hole", "1", "higher", 4),
    "gradient_ratio": Kind("gradient energy, hole : surround", "1", "nearer 1", 2),
}


@dataclass(frozen=True)
class Score:
    """One figure of one view."""

    protocol: str
    method: str
    view: str
    metric: str
    value: float


@dataclass
class Scores:
    """Figures in the order they were taken."""

    rows: list[Score] = field(default_factory=list)

    def add(self, protocol: str, method: str, view: str, figures: dict[str, float]) -> None:
        self.rows += [Score(protocol, method, view, name, round_figure(value)) for name, value in figures.items()]

    def means(self, protocol: str) -> list[Metric]:
        """One Metric for each method and figure of a protocol: the mean over its views, and the bootstrap's interval.

        Views that equal the truth have no finite PSNR: they are counted, and not in the mean. A figure that no view has
        a finite value of is left out.
        """
        groups: dict[tuple[str, str], list[float]] = {}
        for row in self.rows:
            if row.protocol == protocol:
                groups.setdefault((row.method, row.metric), []).append(row.value)
        return [m for (method, name), v in groups.items() if (m := average(method, name, v)) is not None]

    def write(self, path: Path) -> None:
        """A table: protocol, method, view, metric, value."""
        with path.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["protocol", "method", "view", "metric", "value"])
            table.writerows((r.protocol, r.method, r.view, r.metric, r.value) for r in self.rows)


def average(method: str, name: str, values: list[float]) -> Metric | None:
    """The mean of a figure over its views with the 95 % interval; None where no value is finite."""
    finite = np.array([v for v in values if math.isfinite(v)])
    if not finite.size:
        return None
    low, high = bootstrap_interval(finite) if finite.size > 1 else (None, None)
    return metric(
        method, name, float(np.mean(finite)), finite.size, low=low, high=high, equal_views=sum(map(math.isinf, values))
    )


def bootstrap_interval(values: NDArray[np.float64]) -> tuple[float, float]:
    """Percentile bootstrap of the mean of values [n] (Efron 1979): where 95 % of the resampled means lie.

    The resamples are the same for equal n, so that methods on the same views are compared alike. Too narrow for few
    views, as every such interval.
    """
    drawn = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    tail = (1.0 - CONFIDENCE) / 2
    low, high = np.quantile(values[drawn].mean(1), [tail, 1.0 - tail])
    return float(low), float(high)


def metric(
    method: str,
    name: str,
    value: float,
    views: int,
    *,
    low: float | None = None,
    high: float | None = None,
    standard_error: float | None = None,
    equal_views: int = 0,
) -> Metric:
    """A figure in the artifact's form."""
    kind = KINDS[name]
    low, high, standard_error = (None if v is None else round_figure(v) for v in (low, high, standard_error))
    return Metric(
        method=method, name=name, title=kind.title, value=round_figure(value), digits=kind.digits, unit=kind.unit,
        better=kind.better, views=views, low=low, high=high, standard_error=standard_error, equal_views=equal_views,
    )  # fmt: skip


def round_figure(value: float) -> float:
    """Six decimals, which is more than any figure means."""
    return round(float(value), 6)
