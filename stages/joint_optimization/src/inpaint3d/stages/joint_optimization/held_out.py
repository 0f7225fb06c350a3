"""How well a field shows views that it was not fitted to: known pixels only."""

from collections.abc import Sequence

import numpy as np
import torch

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.training import psnr
from inpaint3d.scene.masked_views import MaskedView


class HeldOut:
    """A fixed random choice of known pixels of each test view: whole views would cost more than the steps between."""

    def __init__(self, views: Sequence[MaskedView], pixels: int, device: str) -> None:
        rng = np.random.default_rng(0)
        self._views: list[tuple[Rays, np.ndarray]] = []
        for view in views:
            y, x = np.nonzero(view.known)
            if len(x):
                chosen = rng.choice(len(x), min(pixels, len(x)), replace=False)
                xy = np.stack([x[chosen] + 0.5, y[chosen] + 0.5], -1)
                self._views.append((camera_rays(view.camera, xy, device=device), view.image[y[chosen], x[chosen]]))

    @torch.no_grad()
    def psnr(self, field: RadianceField, block: int) -> float | None:
        """Mean over the views of their PSNR in dB, mean appearance code; None without test views."""
        if not self._views:
            return None
        scores = []
        for rays, truth in self._views:
            parts = [render(field, rays[i : i + block], glo="mean").rgb for i in range(0, len(truth), block)]
            scores.append(psnr(torch.cat(parts).clamp(0, 1).cpu().numpy(), truth))
        return float(np.mean(scores))
