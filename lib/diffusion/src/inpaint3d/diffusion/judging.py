"""Judging a prior on pictures whose holes are known: hole PSNR beside classical fills, and grids to look at."""

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from inpaint3d.diffusion.denoiser import Image, Mask
from inpaint3d.diffusion.fill import fill_telea, pyramid_fill
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.samplers import inpaint


def hole_psnr(filled: Image, truth: Image, mask: Mask) -> Float[Tensor, "b"]:
    """PSNR over the hole alone, dB, of pictures in [-1, 1] (peak 2); one per picture, infinite where they are equal."""
    squared = ((filled - truth).square() * mask).sum(dim=(1, 2, 3)) / (3 * mask.sum(dim=(1, 2, 3)))
    return 10 * torch.log10(4 / squared)


def fill_batch_telea(image: Image, mask: Mask, radius: float = 3.0) -> Image:
    """`fill_telea`, picture by picture."""
    shown = ((image + 1) / 2).permute(0, 2, 3, 1).contiguous().cpu().numpy()
    holes = mask[:, 0].bool().cpu().numpy()
    filled = [fill_telea(picture, hole, radius) for picture, hole in zip(shown, holes, strict=True)]
    return torch.from_numpy(np.stack(filled)).to(image.device).permute(0, 3, 1, 2) * 2 - 1


def mean_estimate(prior: InpaintingPrior, image: Image, mask: Mask, generator: torch.Generator) -> Image:
    """The clean picture that the prior expects before it has seen any of z: one call at t = 1."""
    noise, noise_fill = (
        torch.randn(image.shape, generator=generator, device=generator.device).to(image) for _ in range(2)
    )
    with torch.no_grad():
        clean = prior.estimate(noise, torch.ones(len(image)).to(image), image, mask, noise_fill).clean
    return torch.where(mask > 0, clean.clamp(-1, 1), image)


def fill_each_way(
    prior: InpaintingPrior, image: Image, mask: Mask, generator: torch.Generator, *, steps: int = 8, batch: int = 16
) -> dict[str, Image]:
    """The prior's samples and expectation, and two classical fills, by name.

    A sample is not meant to win PSNR (the expectation is), but noise and wrong colours lose it.
    """
    parts = [(image[i : i + batch], mask[i : i + batch]) for i in range(0, len(image), batch)]
    samples = torch.cat([inpaint(prior, x, m, steps=steps, generator=generator) for x, m in parts])
    expected = torch.cat([mean_estimate(prior, x, m, generator) for x, m in parts])
    return {
        "sample": samples,
        "expectation": expected,
        "pyramid": pyramid_fill(image, mask),
        "telea": fill_batch_telea(image, mask),
    }


def draw_grid(
    image: Image, mask: Mask, samples: Image, expected: Image | None = None
) -> UInt8[np.ndarray, "rows columns 3"]:
    """One row per picture: hole in grey, sample, expectation if given, truth; with 2 px between them."""
    columns = [torch.where(mask > 0, 0.0, image), samples, *([] if expected is None else [expected]), image]
    rows = []
    for pictures in zip(*columns, strict=True):
        rows.append(np.concatenate([np.pad(to_bytes(p), ((1, 1), (1, 1), (0, 0))) for p in pictures], axis=1))
    return np.concatenate(rows, axis=0)


def to_bytes(picture: Float[Tensor, "3 h w"]) -> UInt8[np.ndarray, "rows columns 3"]:
    """A picture in [-1, 1] at 8 bits."""
    return ((picture.permute(1, 2, 0).cpu() + 1) * 127.5).round().clamp(0, 255).byte().contiguous().numpy()
