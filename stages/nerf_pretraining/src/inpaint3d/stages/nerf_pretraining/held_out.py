"""How well a field shows the views that it was not fitted to."""

import math
from collections.abc import Sequence

import numpy as np
import torch

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.training import psnr
from inpaint3d.scene.capture_io import View


class HeldOut:
    """Pixels of held-out views on a regular lattice: the score is the full picture's, at a fraction of its cost.

    Nothing is averaged down, since a small picture would score higher than the large one that it stands for.
    """

    def __init__(self, views: Sequence[View], longest_side: int, device: torch.device | str) -> None:
        lattices = [_lattice(view, longest_side, device) for view in views]
        self._views = [(rays, truth) for rays, truth in lattices if len(truth)]

    def psnr(self, field: RadianceField, block: int) -> float:
        """Mean over views of the PSNR in dB, mean appearance code; NaN where there are no views."""
        scores = [_score(field, rays, truth, block) for rays, truth in self._views]
        return math.fsum(scores) / len(scores) if scores else math.nan


def _lattice(view: View, longest_side: int, device: torch.device | str) -> tuple[Rays, np.ndarray]:
    """Rays and colours of about `longest_side` pixels along the longest side, those that the view really has."""
    step = max(1, math.ceil(max(view.camera.width, view.camera.height) / longest_side))
    pixels = np.s_[step // 2 :: step, step // 2 :: step]
    real = view.valid()[pixels]
    xy = view.camera.pixel_centres()[pixels][real]
    return camera_rays(view.camera, xy, device=device), view.image()[pixels][real]


@torch.no_grad()
def _score(field: RadianceField, rays: Rays, truth: np.ndarray, block: int) -> float:
    parts = [render(field, rays[start : start + block]).rgb for start in range(0, len(truth), block)]
    return psnr(torch.cat(parts).clamp(0, 1).cpu().numpy(), truth)
