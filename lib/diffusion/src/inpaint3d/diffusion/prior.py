"""The inpainting prior: a denoiser that is shown a picture with a hole, and the one way to query it.

Pictures are in [-1, 1], masks are 1 inside the hole, z_t is noised everywhere. What the network really sees (noise or a
fill in the hole, clean or noised known pixels) is in the spec, and training and every query go through the same
`prepare_z` and `fill_hole`, so that the prior is asked exactly what it was taught.
"""

import math
from dataclasses import dataclass

import torch
from torch import nn

from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion.bands import pixel_variance, to_opponent
from inpaint3d.diffusion.denoiser import Image, Mask, Times, guide_noise
from inpaint3d.diffusion.fill import pyramid_fill
from inpaint3d.diffusion.parameterisation import Parameterisation
from inpaint3d.diffusion.schedules import cosine_log_snr
from inpaint3d.diffusion.unet import EfficientUNet


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
    """A `Denoiser`: EfficientUNet plus the convention of its spec (conformance D5 to D11).

    bf16: run the network under bfloat16 autocast. Weights, inputs and outputs stay float32.
    network: what runs instead of an EfficientUNet with random weights of this seed.
    """

    bound = 1.0

    def __init__(self, spec: PriorSpec, seed: int = 0, *, bf16: bool = False, network: nn.Module | None = None) -> None:
        super().__init__()
        self.spec = spec
        self.bf16 = bf16
        self.network = _make_random_network(spec, seed) if network is None else network

    @property
    def size(self) -> int:
        return self.spec.size

    @property
    def latent_shape(self) -> tuple[int, int, int]:
        return (3, self.size, self.size)

    def encode(self, image: Image) -> Image:
        """The image itself: this prior denoises pixels."""
        return image

    def decode(self, latent: Image) -> Image:
        """The image itself."""
        return latent

    def fill_hole(self, image: Image, mask: Mask, noise_fill: Image | None = None) -> Image:
        """The picture as the condition shows it: known pixels, and in the hole noise (D5) or a smooth fill.

        What `image` holds under the mask is never looked at. noise_fill: N(0, 1), needed by `noise-fill` priors only.
        """
        if self.spec.condition == "mask-channel":
            return pyramid_fill(image, mask)
        if noise_fill is None:
            raise ValueError("this prior shows the hole as noise: pass noise_fill, N(0, 1) of the image's shape")
        return torch.where(mask > 0, noise_fill, image)

    def parameterisation(self, t: Times) -> Parameterisation:
        """What the output means at these noise levels."""
        return Parameterisation(self.spec.prediction, t, self.spec.residual_bands, self.spec.residual_colours)

    def prepare_z(self, z: Image, t: Times, fill: Image, mask: Mask) -> Image:
        """z_t as this prior sees it: noised everywhere (D9), or without noise on the known pixels, alpha(t) x."""
        if self.spec.known == "noised":
            return z
        a, _ = self.parameterisation(t).levels
        return torch.where(mask > 0, z, a * fill)

    def forward(self, z: Image, t: Times, fill: Image, mask: Mask) -> Image:
        """The network's raw output for z_t as of `prepare_z`; its meaning is `spec.prediction`."""
        channels = [z, fill]
        if self.spec.prediction == "residual":
            # z itself would be all noise near t = 1, and the network would have to learn to ignore it. The linear guess
            # holds the same information about x, and becomes the fill there.
            guess = self.parameterisation(t).linear_guess(z, fill)
            spread = math.sqrt(pixel_variance(self.spec.residual_bands)) * torch.tensor(self.spec.residual_colours)
            channels = [to_opponent(guess - fill) / spread.to(z)[:, None, None], fill]
        if self.spec.condition == "mask-channel":
            channels.append(mask * 2 - 1)
        with torch.autocast(z.device.type, torch.bfloat16, enabled=self.bf16):
            return self.network(torch.cat(channels, dim=1), cosine_log_snr(t)).float()

    def estimate(self, z: Image, t: Times, image: Image, mask: Mask, noise_fill: Image | None = None) -> Estimate:
        """Clean picture and noise under one condition, without guidance.

        Known pixels of a `clean` prior are known: there the estimate is the image itself and the noise that z_t then
        must hold.
        """
        fill = self.fill_hole(image, mask, noise_fill)
        parameterisation, seen = self.parameterisation(t), self.prepare_z(z, t, fill, mask)
        output = self(seen, t, fill, mask)
        clean, noise = parameterisation.clean(output, seen, fill), parameterisation.noise(output, seen, fill)
        if self.spec.known == "clean":
            a, s = parameterisation.levels
            clean = torch.where(mask > 0, clean, image)
            noise = torch.where(mask > 0, noise, (z - a * image) / s)
        return Estimate(clean, noise)

    def predict_noise(
        self, z: Image, t: Times, image: Image, mask: Mask, *, guidance: float = 1.0, noise_fill: Image | None = None
    ) -> Image:
        """eps_hat(z_t; t, y) of the paper, guided; the null condition is the all-hole picture (D11): it stays
        in-distribution. z is noised everywhere; `image` under the mask is never looked at.
        """

        def noise(image: Image, mask: Mask) -> Image:
            return self.estimate(z, t, image, mask, noise_fill).noise

        return guide_noise(
            lambda: noise(image, mask), lambda: noise(torch.zeros_like(image), torch.ones_like(mask)), guidance
        )


def input_channels(spec: PriorSpec) -> int:
    """Channels that the network is shown: z or its linear guess, the picture, and the mask where the spec has one."""
    return 6 if spec.condition == "noise-fill" else 7


def _make_random_network(spec: PriorSpec, seed: int) -> EfficientUNet:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return EfficientUNet(
            input_channels(spec),
            3,
            width=spec.width,
            multipliers=spec.multipliers,
            blocks=spec.blocks,
            attention=spec.attention,
            packing=spec.packing,
        )
