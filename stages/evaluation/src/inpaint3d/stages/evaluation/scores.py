"""Figures by protocol, method and view; their means are what the artifact states."""

import csv
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from inpaint3d.contracts.models.artifacts import Metric


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
        """One Metric for each method and figure of a protocol: the mean over its views."""
        groups: dict[tuple[str, str], list[float]] = {}
        for row in self.rows:
            if row.protocol == protocol:
                groups.setdefault((row.method, row.metric), []).append(row.value)
        return [metric(method, name, float(np.mean(v)), len(v)) for (method, name), v in groups.items()]

    def write(self, path: Path) -> None:
        """A table: protocol, method, view, metric, value."""
        with path.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["protocol", "method", "view", "metric", "value"])
            table.writerows((r.protocol, r.method, r.view, r.metric, r.value) for r in self.rows)


def metric(method: str, name: str, value: float, views: int) -> Metric:
    """A figure in the artifact's form."""
    kind = KINDS[name]
    return Metric(
        method=method, name=name, title=kind.title, value=round_figure(value), digits=kind.digits, unit=kind.unit,
        better=kind.better, views=views,
    )  # fmt: skip


def round_figure(value: float) -> float:
    """Six decimals, which is more than any figure means."""
    return round(float(value), 6)
