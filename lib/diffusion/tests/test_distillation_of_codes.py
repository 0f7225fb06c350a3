"""Distillation by priors over an autoencoder's codes. Autoencoders that are linear make it exact."""

from pathlib import Path

import pytest
import torch
import torch.nn.functional as F
from diffusers import LDMPipeline
from diffusers.models.autoencoders.autoencoder_tiny import AutoencoderTinyOutput
from diffusers.models.autoencoders.vae import DecoderOutput
from torch import Tensor, nn

from inpaint3d.diffusion.denoiser import Denoiser
from inpaint3d.diffusion.distillation import (
    PriorQuery,
    denoised_target,
    denoised_target_gradient,
    ism_gradient,
    nfsd_gradient,
    sdi_gradient,
    sds_gradient,
)
from inpaint3d.diffusion.pipelines import PipelinePrior
from inpaint3d.diffusion.schedules import alpha, per_image, sigma
from tests.tiny_pipelines import latent_pipeline, pixel_pipeline

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")

T = torch.tensor([0.35, 0.8])


class BlockMeans(nn.Module):
    """An autoencoder as diffusers has them: the code is `scale` times the means of blocks of `side` x `side` pixels."""

    def __init__(self, side: int, scale: float = 1.0) -> None:
        super().__init__()
        self.side = side
        self.config = {"block_out_channels": (1,) * side.bit_length(), "scaling_factor": scale}

    def encode(self, image: Tensor) -> AutoencoderTinyOutput:
        return AutoencoderTinyOutput(latents=F.avg_pool2d(image, self.side))

    def decode(self, code: Tensor) -> DecoderOutput:
        return DecoderOutput(sample=F.interpolate(code, scale_factor=self.side))


def over_codes(vae: nn.Module) -> PipelinePrior:
    """The UNet and the scheduler of the tiny pipeline over pixels, behind an autoencoder."""
    pixels = pixel_pipeline()
    return PipelinePrior(LDMPipeline(vqvae=vae, unet=pixels.unet, scheduler=pixels.scheduler))


@pytest.fixture
def picture() -> Tensor:
    coarse = torch.rand(2, 3, 4, 4, generator=torch.Generator().manual_seed(7)) * 2 - 1
    return F.interpolate(coarse, size=32, mode="bilinear")


@pytest.fixture
def hole() -> Tensor:
    """Its border cuts blocks of 2 x 2 pixels."""
    mask = torch.zeros(2, 1, 32, 32)
    mask[:, :, 9:20, 10:25] = 1
    return mask


def _eps(prior: Denoiser, seed: int = 0) -> Tensor:
    return torch.randn(2, *prior.latent_shape, generator=torch.Generator().manual_seed(seed))


def _gradients(prior: PipelinePrior, x: Tensor, mask: Tensor, **options: float) -> dict[str, Tensor]:
    eps = _eps(prior)
    return {
        "sds": sds_gradient(prior, PriorQuery(x, mask, T, eps), **options),
        "nfsd": nfsd_gradient(prior, PriorQuery(x, mask, T, eps), **options),
        "sdi": sdi_gradient(prior, PriorQuery(x, mask, T), steps=2, **options),
        "ism": ism_gradient(prior, PriorQuery(x, mask, T), steps=2, **options),
        "denoised-target": denoised_target_gradient(prior, PriorQuery(x, mask, T, eps), steps=1, **options),
    }


@pytest.mark.parametrize("guidance", [1.0, 3.0])
def test_codes_that_are_the_pixels_give_what_pixels_give(picture, hole, guidance) -> None:
    """To the bit, but for the target in one step: only pixels are clipped on the way, and at t = 0 the schedule leaves
    sigma = 4.5e-5 of noise.
    """
    pixels, codes = PipelinePrior(pixel_pipeline()), over_codes(BlockMeans(1))
    assert codes.latent_shape == pixels.latent_shape == (3, 32, 32)
    expected = _gradients(pixels, picture, hole, guidance=guidance)
    for name, gradient in _gradients(codes, picture, hole, guidance=guidance).items():
        tolerance = 2e-4 if name == "denoised-target" else 0.0
        torch.testing.assert_close(gradient, expected[name], rtol=0, atol=tolerance, msg=name)


def test_pixels_of_a_block_share_what_pulls_their_code(picture, hole) -> None:
    """The transposed Jacobian of a mean times the pixels of a code: each pixel gets its code's gradient, scaled."""
    prior = over_codes(BlockMeans(2, scale=0.5))
    assert prior.latent_shape == (3, 32, 32)
    assert prior.size == 64
    x, mask = F.interpolate(picture, scale_factor=2), F.interpolate(hole, scale_factor=2)
    mask[..., 20:22, :] = 0  # some blocks are cut
    mask[..., 21:22, :] = 1
    eps, a, s = _eps(prior), per_image(alpha(T)), per_image(sigma(T))
    z = a * 0.5 * F.avg_pool2d(x, 2) + s * eps
    push = s**2 * (prior.predict_noise(z, T, x, mask) - eps)
    expected = 0.5 * F.interpolate(push * F.max_pool2d(mask, 2), scale_factor=2) * mask
    torch.testing.assert_close(sds_gradient(prior, PriorQuery(x, mask, T, eps)), expected)


class Certain:
    """A `Denoiser` of means of 2 x 2 pixels that believes in one picture, whatever it is shown."""

    bound = None

    def __init__(self, belief: Tensor) -> None:
        self.size, self.code = belief.shape[-1], self.encode(belief)

    @property
    def latent_shape(self) -> tuple[int, int, int]:
        return (3, self.size // 2, self.size // 2)

    def encode(self, image: Tensor) -> Tensor:
        return F.avg_pool2d(image, 2)

    def decode(self, latent: Tensor) -> Tensor:
        return F.interpolate(latent, scale_factor=2)

    def predict_noise(self, z: Tensor, t: Tensor, image: Tensor, mask: Tensor, **options: object) -> Tensor:
        return (z - per_image(alpha(t)) * self.code) / per_image(sigma(t))


def test_descending_reaches_the_codes_that_the_prior_believes_in(picture) -> None:
    mask = torch.zeros(2, 1, 32, 32)
    mask[:, :, 8:20, 10:26] = 1
    belief = picture.roll(5, -1)
    prior = Certain(belief)
    x = torch.where(mask > 0, -belief, belief)
    for i in range(60):
        x = x - 0.5 / per_image(alpha(T) * sigma(T)) * sds_gradient(prior, PriorQuery(x, mask, T, _eps(prior, i)))
    # Half of what is left is gone with each step; alpha x + sigma eps - alpha code cancels digits of float32.
    torch.testing.assert_close(prior.encode(x), prior.code, rtol=0, atol=1e-5)
    assert torch.equal(x * (1 - mask), belief * (1 - mask))


def test_the_denoised_target_is_decoded(picture, hole) -> None:
    prior = over_codes(BlockMeans(2))
    x, mask = F.interpolate(picture, scale_factor=2), F.interpolate(hole, scale_factor=2)
    target = denoised_target(prior, PriorQuery(x, mask, T, _eps(prior)), steps=3)
    blocks = F.interpolate(F.avg_pool2d(target, 2), scale_factor=2)
    inside = (mask > 0).expand_as(x)
    torch.testing.assert_close(target[inside], blocks[inside])
    assert torch.equal(target[~inside], x[~inside])
    assert target.abs().max() <= 1


@pytest.mark.parametrize("guidance", [1.0, 3.0])
@pytest.mark.parametrize("kind", ["9 channels", "4 channels", "pixels"])
def test_every_gradient_is_finite_and_of_the_hole_alone(kind, guidance, picture, hole, tmp_path: Path) -> None:
    """What the network is not shown, two conditions of nfsd do not differ in: see `joint_optimization.priors`."""
    pipeline = pixel_pipeline() if kind == "pixels" else latent_pipeline(tmp_path, int(kind[0]))
    prior = PipelinePrior(pipeline, prompt="chair")
    hidden = torch.where(hole > 0, -picture, picture)
    for name, gradient in _gradients(prior, picture, hole, guidance=guidance).items():
        assert gradient.shape == picture.shape
        assert gradient.isfinite().all(), name
        assert torch.equal(gradient * (1 - hole), torch.zeros_like(gradient)), name
        if name == "nfsd" and (kind == "pixels" or (kind == "4 channels" and guidance == 1.0)):
            assert not gradient.any()
        else:
            assert gradient.any(), name
    assert not any(p.requires_grad for p in prior.unet.parameters())
    noise = [prior.predict_noise(_eps(prior), T, x, hole, guidance=guidance) for x in (picture, hidden)]
    assert torch.equal(*noise)
