"""Samplers as plain functions. `predict` is eps_hat(z, t).

`times` fall from 1 (or where z was noised to) to 0, one more than there are steps: [n] for all images of the batch, or
[n, b] where each image has its own.
"""

import itertools
from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.diffusion.prior import Image, InpaintingPrior, Mask
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

Predict = Callable[[Tensor, Tensor], Tensor]


def uniform_times(steps: int, start: float = 1.0) -> Float[Tensor, "n"]:
    """start, ..., 0 in `steps` equal steps."""
    return torch.linspace(start, 0, steps + 1)


def ddpm(
    predict: Predict,
    z: Float[Tensor, "b c h w"],
    times: Float[Tensor, "n *b"],
    *,
    generator: torch.Generator,
    clip: float | None = None,
) -> Float[Tensor, "b c h w"]:
    """Ancestral sampling (DDPM, arXiv:2006.11239, algorithm 2; in continuous time VDM, arXiv:2107.00630, eq. 33).

    clip bounds the clean estimate, e.g. 1 for pictures in [-1, 1].
    """
    for t, s in _pairs(times, z):
        a_t, s_t, a_s, s_s = _levels(t, s)
        clean = _clean(predict(z, t), z, a_t, s_t, clip)
        # 1 - SNR(t) / SNR(s): the share of z_t's noise that came in after s.
        fresh = 1 - (a_t * s_s / (s_t * a_s)) ** 2
        mean = (a_t / a_s) * (s_s / s_t) ** 2 * z + a_s * fresh * clean
        z = mean + s_s * fresh.sqrt() * torch.randn(z.shape, generator=generator).to(z)
    return z


def ddim(
    predict: Predict, z: Float[Tensor, "b c h w"], times: Float[Tensor, "n *b"], *, clip: float | None = None
) -> Float[Tensor, "b c h w"]:
    """Deterministic sampling (DDIM, arXiv:2010.02502, eq. 12 with sigma = 0)."""
    for t, s in _pairs(times, z):
        a_t, s_t, a_s, s_s = _levels(t, s)
        clean = _clean(predict(z, t), z, a_t, s_t, clip)
        noise = (z - a_t * clean) / s_t
        z = a_s * clean + s_s * noise
    return z


def inpaint(
    prior: InpaintingPrior,
    image: Image,
    mask: Mask,
    *,
    steps: int,
    generator: torch.Generator,
    guidance: float = 1.0,
    ancestral: bool = False,
) -> Image:
    """A sample of what may be in the hole, in [-1, 1]; known pixels come back untouched."""
    noise = torch.randn(image.shape, generator=generator).to(image)
    noise_fill = torch.randn(image.shape, generator=generator).to(image)

    def predict(z: Tensor, t: Tensor) -> Tensor:
        return prior.predict_noise(z, t, image, mask, guidance=guidance, noise_fill=noise_fill)

    times = uniform_times(steps)
    with torch.no_grad():
        if ancestral:
            sample = ddpm(predict, noise, times, generator=generator, clip=1.0)
        else:
            sample = ddim(predict, noise, times, clip=1.0)
    return torch.where(mask > 0, sample.clamp(-1, 1), image)


def _pairs(times: Tensor, z: Tensor) -> list[tuple[Tensor, Tensor]]:
    """(t, s) of each step, one number per image: from t to the less noisy s."""
    rows = times.to(z).reshape(len(times), -1).expand(-1, z.shape[0])
    return list(itertools.pairwise(rows))


def _levels(t: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return per_image(alpha(t)), per_image(sigma(t)), per_image(alpha(s)), per_image(sigma(s))


def _clean(noise: Tensor, z: Tensor, a: Tensor, s: Tensor, clip: float | None) -> Tensor:
    clean = (z - s * noise) / a
    return clean if clip is None else clean.clamp(-clip, clip)
