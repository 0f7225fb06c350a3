"""What all protocols share: the methods with their renders, and pictures compared with pictures."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import torch

from inpaint3d.contracts.models.artifacts import Metric
from inpaint3d.perception import lpips
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.ssim import ssim
from inpaint3d.stages.evaluation.config import Config
from inpaint3d.stages.evaluation.features import lite0_features
from inpaint3d.stages.evaluation.frechet import estimate_kernel_distance, frechet_distance
from inpaint3d.stages.evaluation.methods import Maps, Method, count_non_finite
from inpaint3d.stages.evaluation.photos import Photo
from inpaint3d.stages.evaluation.scores import Scores, metric

Tick = Callable[[str], None]


@dataclass
class Bench:
    """What all protocols share: the methods, the table, the renders so far, and the count of non-finite values."""

    methods: list[Method]
    config: Config
    tick: Tick
    scores: Scores = field(default_factory=Scores)
    non_finite: dict[str, int] = field(default_factory=dict)
    renders: dict[tuple[str, str], Maps] = field(default_factory=dict)

    @property
    def device(self) -> torch.device:
        """Where the fields lie, and where networks look at pictures."""
        return self.methods[0].field.device

    def render_full_view(self, method: Method, photo: Photo) -> Maps:
        """The whole view, rendered once."""
        key = (method.label, photo.name)
        if key not in self.renders:
            self.renders[key] = method.render(photo, self.config.block)
            self.tick(f"{method.label} in {photo.name}")
        return self.renders[key]

    def check_finite(self, renders: dict[str, Maps], view: str) -> bool:
        """Count the non-finite values of a view's renders; a view that has any is left out for every method."""
        counts = {label: count_non_finite(maps) for label, maps in renders.items()}
        for label, count in counts.items():
            if count:
                place = f"{label}/{view}"
                self.non_finite[place] = max(count, self.non_finite.get(place, 0))
        return not any(counts.values())


def compare_pictures(
    pictures: Mapping[str, Image],
    truth: Image,
    *,
    perceptual: bool,
    region: np.ndarray | None = None,
    device: torch.device | str = "cpu",
) -> dict[str, dict[str, float]]:
    """PSNR, SSIM and (where wanted) both LPIPS of each picture against one truth, by label; device: of the networks."""
    figures = {n: {"psnr": psnr(p, truth, region), "ssim": ssim(p, truth, region)} for n, p in pictures.items()}
    if perceptual:
        for network in ("vgg", "alex"):
            distances = lpips.load(network, device).distances(list(pictures.values()), truth)
            for label, distance in zip(pictures, distances, strict=True):
                figures[label][f"lpips_{network}"] = distance
    return figures


def set_distances(
    crops: dict[str, list[Image]], truths: list[Image], device: torch.device | str = "cpu"
) -> list[Metric]:
    """FD-lite0 and KID-lite0 of each method's crops to the truth's."""
    real = lite0_features(truths, device)
    out: list[Metric] = []
    for label, pictures in crops.items():
        made = lite0_features(pictures, device)
        out.append(metric(label, "fd_lite0", frechet_distance(made, real), len(truths)))
        kernel = estimate_kernel_distance(made, real)
        out.append(metric(label, "kid_lite0", kernel.value, len(truths), standard_error=kernel.standard_error))
    return out


def ring_width(config: Config, width: int, height: int) -> int:
    """Pixels of the ring around a mask whose tight box is width x height."""
    return max(2, round(config.ring * max(width, height)))


def describe_resolution(config: Config) -> str:
    """What the renders of a view are compared at, in words."""
    return f"at most {config.render_longest_side} px a side, reduced by exact area means"
