"""What the prior says of a rendered patch: one constant gradient for its hole (rows S2 to S5, L8)."""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from inpaint3d.diffusion.distillation import denoised_target_gradient, sds_gradient
from inpaint3d.diffusion.prior import InpaintingPrior

Patch = Float[Tensor, "h w 3"]
Hole = Bool[Tensor, "h w"]


@dataclass(frozen=True)
class Guide:
    """A prior with the estimator that turns its opinion into a gradient."""

    prior: InpaintingPrior
    estimator: Literal["sds", "denoised-target"]
    guidance: float
    denoise_steps: int

    def gradient(
        self, patch: Patch, hole: Hole, timesteps: tuple[float, float], generator: torch.Generator
    ) -> tuple[Patch, float]:
        """d(loss)/d(patch) for a patch rendered in [0, 1], and the diffusion time t that was drawn.

        t, the noise and the fill of the condition are fresh at every call (S3). Outside the hole the gradient is 0. It
        is that of a mean over the patch's pixels, of a picture in [-1, 1]: hence the factor 2 and the division (L8).
        """
        low, high = timesteps
        t = low + (high - low) * torch.rand((), generator=generator).item()
        x = (2.0 * patch.detach() - 1.0).permute(2, 0, 1)[None]
        mask = hole[None, None].to(x)
        eps = torch.randn(x.shape, generator=generator).to(x)
        noise_fill = torch.randn(x.shape, generator=generator).to(x)
        estimate = self._estimate(x, mask, torch.full((1,), t).to(x), eps, noise_fill)
        pixels = patch.shape[0] * patch.shape[1]
        return estimate[0].permute(1, 2, 0) * (2.0 / pixels), t

    def _estimate(self, x: Tensor, mask: Tensor, t: Tensor, eps: Tensor, noise_fill: Tensor) -> Tensor:
        if self.estimator == "sds":
            return sds_gradient(self.prior, x, mask, t, eps, guidance=self.guidance, noise_fill=noise_fill)
        return denoised_target_gradient(
            self.prior, x, mask, t, eps, guidance=self.guidance, noise_fill=noise_fill, steps=self.denoise_steps
        )
