"""Fills against the truth: LPIPS, KID over stand-in features, PSNR in the hole."""

import math
import statistics
from collections.abc import Mapping

import numpy as np
from torch import Tensor

from inpaint3d.diffusion.judging import hole_psnr
from inpaint3d.perception import lpips
from inpaint3d.scene.psnr import mean_psnr
from inpaint3d.stages.evaluation.features import lite0_features
from inpaint3d.stages.evaluation.frechet import kernel_distance


def over_draws(figures: list[dict[str, float]]) -> dict[str, float]:
    """Means over the draws, and KID's standard deviation between them (0 for one)."""
    means = {name: round(statistics.fmean(f[name] for f in figures), 5) for name in figures[0]}
    spread = statistics.stdev(f["kid_lite0"] for f in figures) if len(figures) > 1 else 0.0
    return means | {"kid_lite0_spread": round(spread, 5)}


class Judge:
    """The truths, and what they look like to the networks that judge."""

    def __init__(self, truth: Tensor) -> None:
        self.truth, self.pictures = truth, unit(truth)
        self.features = lite0_features(self.pictures)
        self.network = lpips.load("vgg")

    def figures(self, filled: Mapping[str, Tensor], hole: Tensor) -> dict[str, dict[str, float]]:
        """LPIPS, KID and PSNR of each fill of all photos; a truth's features are taken once for all fills."""
        pictures = {name: unit(fill) for name, fill in filled.items()}
        distances = np.mean(
            [
                self.network.distances([of_fill[i] for of_fill in pictures.values()], truth)
                for i, truth in enumerate(self.pictures)
            ],
            axis=0,
        )
        return {
            name: {
                "lpips": round(float(distance), 4),
                "kid_lite0": round(kernel_distance(lite0_features(pictures[name]), self.features), 5),
                "psnr": round(mean_psnr(hole_psnr(fill, self.truth, hole).tolist()) or math.nan, 2),
            }
            for (name, fill), distance in zip(filled.items(), distances, strict=True)
        }


def unit(pictures: Tensor) -> list[np.ndarray]:
    """[b, 3, h, w] in [-1, 1] as pictures [h, w, 3] in [0, 1]."""
    return list(((pictures + 1) / 2).permute(0, 2, 3, 1).numpy())


def find_best(rows: dict[str, dict[str, float]]) -> list[str]:
    """The figures at which no other fill is as good as ours."""
    others = [row for name, row in rows.items() if name != "ours"]
    lower = [name for name in ("lpips", "kid_lite0") if all(rows["ours"][name] < row[name] for row in others)]
    return lower + [name for name in ("psnr",) if all(rows["ours"][name] > row[name] for row in others)]
