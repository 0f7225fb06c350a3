"""The inpainting prior: a denoiser that is shown a picture with a hole, and the one way to query it.

Pictures are in [-1, 1], masks are 1 inside the hole, z_t is noised everywhere. What the network really sees (noise or a
fill in the hole, clean or noised known pixels) is in the spec, and training and every query go through the same
`network_input`, so that the prior is asked exactly what it was taught.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from inpaint3d.contracts.artifacts.prior import PriorSpec
from inpaint3d.diffusion.fill import pyramid_fill
from inpaint3d.diffusion.parameterisation import clean_from_output, noise_from_output
from inpaint3d.diffusion.schedules import alpha, cosine_log_snr, per_image, sigma
from inpaint3d.diffusion.unet import EfficientUNet

Image = Float[Tensor, "b 3 h w"]
Mask = Float[Tensor, "b 1 h w"]
Times = Float[Tensor, "b"]


@dataclass(frozen=True)
class Estimate:
    """What a denoiser believes of z_t = alpha x + sigma eps."""

    clean: Image
    noise: Image


def bf16_pays(device: str = "cpu") -> bool:
    """Whether matrix products in bfloat16 are faster here: GPUs, and processors with AMX (1.8 times a training step).

    Without AMX bfloat16 is a quarter to a half slower than float32.
    """
    return device != "cpu" or bool(torch.cpu.get_capabilities().get("amx_bf16", False))


class InpaintingPrior(nn.Module):
    """EfficientUNet plus the convention of its spec (conformance D5 to D11).

    bf16: run the network under bfloat16 autocast. Weights, inputs and outputs stay float32.
    """

    def __init__(self, spec: PriorSpec, seed: int = 0, *, bf16: bool = False) -> None:
        super().__init__()
        self.spec = spec
        self.bf16 = bf16
        channels = 6 if spec.condition == "noise-fill" else 7
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = EfficientUNet(
                channels,
                3,
                width=spec.width,
                multipliers=spec.multipliers,
                blocks=spec.blocks,
                attention=spec.attention,
                packing=spec.packing,
            )

    def filled(self, image: Image, mask: Mask, noise_fill: Image | None = None) -> Image:
        """The picture as the condition shows it: known pixels, and in the hole noise (D5) or a smooth fill.

        What `image` holds under the mask is never looked at. noise_fill: N(0, 1), needed by `noise-fill` priors only.
        """
        if self.spec.condition == "mask-channel":
            return pyramid_fill(image, mask)
        if noise_fill is None:
            raise ValueError("this prior shows the hole as noise: pass noise_fill, N(0, 1) of the image's shape")
        return torch.where(mask > 0, noise_fill, image)

    def network_input(self, z: Image, fill: Image, mask: Mask) -> Float[Tensor, "b c h w"]:
        """z_t and the condition, as one stack of channels."""
        if self.spec.known == "clean":
            z = torch.where(mask > 0, z, fill)
        if self.spec.condition == "noise-fill":
            return torch.cat([z, fill], dim=1)
        return torch.cat([z, fill, mask * 2 - 1], dim=1)

    def forward(self, z: Image, t: Times, fill: Image, mask: Mask) -> Image:
        """The network's raw output; its meaning is `spec.prediction`."""
        with torch.autocast(z.device.type, torch.bfloat16, enabled=self.bf16):
            return self.network(self.network_input(z, fill, mask), cosine_log_snr(t)).float()

    def estimate(self, z: Image, t: Times, image: Image, mask: Mask, noise_fill: Image | None = None) -> Estimate:
        """Clean picture and noise under one condition, without guidance.

        Known pixels of a `clean` prior are known: there the estimate is the image itself and the noise that z_t then
        must hold.
        """
        fill = self.filled(image, mask, noise_fill)
        a, s = per_image(alpha(t)), per_image(sigma(t))
        output = self(z, t, fill, mask)
        clean = clean_from_output(self.spec.prediction, output, z, a, s, fill, self.spec.residual_std)
        noise = noise_from_output(self.spec.prediction, output, z, a, s, fill, self.spec.residual_std)
        if self.spec.known == "clean":
            clean = torch.where(mask > 0, clean, image)
            noise = torch.where(mask > 0, noise, (z - a * image) / s)
        return Estimate(clean, noise)

    def guided(
        self, z: Image, t: Times, image: Image, mask: Mask, *, guidance: float = 1.0, noise_fill: Image | None = None
    ) -> Estimate:
        """Classifier-free guidance, eps_null + guidance * (eps_cond - eps_null) (arXiv:2207.12598).

        guidance 1 is the plain conditional estimate and 0 the unconditional one; each costs one network call, any
        other value two. The null condition is the all-hole picture (D11): it stays in-distribution.
        """
        if guidance == 1:
            return self.estimate(z, t, image, mask, noise_fill)
        null = self.estimate(z, t, torch.zeros_like(image), torch.ones_like(mask), noise_fill)
        if guidance == 0:
            return null
        conditional = self.estimate(z, t, image, mask, noise_fill)
        return Estimate(
            null.clean + guidance * (conditional.clean - null.clean),
            null.noise + guidance * (conditional.noise - null.noise),
        )

    def predict_noise(
        self, z: Image, t: Times, image: Image, mask: Mask, *, guidance: float = 1.0, noise_fill: Image | None = None
    ) -> Image:
        """eps_hat(z_t; t, y) of the paper, guided. z is noised everywhere; `image` under the mask is never
        looked at.
        """
        return self.guided(z, t, image, mask, guidance=guidance, noise_fill=noise_fill).noise
