"""Samplers as plain functions. `predict` is eps_hat(z, t).

`times` fall from 1 (or where z was noised to) to 0, one more than there are steps: [n] for all images of the batch, or
[n, b] where each image has its own.
"""

import itertools
from collections.abc import Callable
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.diffusion.denoiser import Denoiser, Image, Mask, check_answer
from inpaint3d.diffusion.schedules import alpha, cosine_log_snr, per_image, sigma

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
    for t, s in _pair_times(times, z):
        a_t, s_t, a_s, s_s = _compute_levels(t, s)
        clean = _clean(check_answer(predict(z, t), t), z, a_t, s_t, clip)
        # 1 - SNR(t) / SNR(s): the share of z_t's noise that came in after s.
        fresh = 1 - (a_t * s_s / (s_t * a_s)) ** 2
        mean = (a_t / a_s) * (s_s / s_t) ** 2 * z + a_s * fresh * clean
        z = mean + s_s * fresh.sqrt() * torch.randn(z.shape, generator=generator, device=generator.device).to(z)
    return z


def ddim(
    predict: Predict, z: Float[Tensor, "b c h w"], times: Float[Tensor, "n *b"], *, clip: float | None = None
) -> Float[Tensor, "b c h w"]:
    """Deterministic sampling (DDIM, arXiv:2010.02502, eq. 12 with sigma = 0).

    With times that rise it goes the other way: inversion, from a picture to the noise that it would be sampled from
    (section 4.3).
    """
    for t, s in _pair_times(times, z):
        a_t, s_t, a_s, s_s = _compute_levels(t, s)
        clean = _clean(check_answer(predict(z, t), t), z, a_t, s_t, clip)
        noise = (z - a_t * clean) / s_t
        z = a_s * clean + s_s * noise
    return z


def dpm_solver(
    predict: Predict, z: Float[Tensor, "b c h w"], times: Float[Tensor, "n *b"], *, clip: float | None = None
) -> Float[Tensor, "b c h w"]:
    """DPM-Solver++(2M): second order from one call a step (arXiv:2211.01095, algorithm 2), lambda = log(alpha / sigma).

    The first step and the last are first order: nothing lies before the one, and the other leaps in lambda, over which
    the line through two estimates would be drawn far beyond them.
    """
    pairs = _pair_times(times, z)
    before, h_before = None, None
    for i, (t, s) in enumerate(pairs):
        a_t, s_t, a_s, s_s = _compute_levels(t, s)
        clean = _clean(check_answer(predict(z, t), t), z, a_t, s_t, clip)
        h = per_image(cosine_log_snr(s) - cosine_log_snr(t)) / 2
        D = clean
        if before is not None and h_before is not None and i < len(pairs) - 1:
            r = h_before / h
            D = (1 + 1 / (2 * r)) * clean - 1 / (2 * r) * before
        z = (s_s / s_t) * z - a_s * torch.expm1(-h) * D
        before, h_before = clean, h
    return z


def inpaint(
    denoiser: Denoiser,
    image: Image,
    mask: Mask,
    *,
    steps: int,
    generator: torch.Generator,
    guidance: float = 1.0,
    sampler: Literal["ddim", "ddpm", "dpm-solver"] = "ddim",
) -> Image:
    """A sample of what may be in the hole, in [-1, 1]; known pixels come back untouched."""
    with torch.no_grad():
        code = denoiser.encode(torch.zeros_like(image))  # its shape alone counts
        noise = torch.randn(code.shape, generator=generator, device=generator.device).to(code)
        noise_fill = torch.randn(image.shape, generator=generator, device=generator.device).to(image)

        def predict(z: Tensor, t: Tensor) -> Tensor:
            return denoiser.predict_noise(z, t, image, mask, guidance=guidance, noise_fill=noise_fill)

        times = uniform_times(steps)
        if sampler == "ddpm":
            sample = ddpm(predict, noise, times, generator=generator, clip=denoiser.bound)
        else:
            solve = ddim if sampler == "ddim" else dpm_solver
            sample = solve(predict, noise, times, clip=denoiser.bound)
        made = check_answer(denoiser.decode(sample), times[-1:])
        return torch.where(mask > 0, made.clamp(-1, 1), image)


def _pair_times(times: Tensor, z: Tensor) -> list[tuple[Tensor, Tensor]]:
    """(t, s) of each step, one number per image: from t to the less noisy s."""
    rows = times.to(z).reshape(len(times), -1).expand(-1, z.shape[0])
    return list(itertools.pairwise(rows))


def _compute_levels(t: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    return per_image(alpha(t)), per_image(sigma(t)), per_image(alpha(s)), per_image(sigma(s))


def _clean(noise: Tensor, z: Tensor, a: Tensor, s: Tensor, clip: float | None) -> Tensor:
    clean = (z - s * noise) / a
    return clean if clip is None else clean.clamp(-clip, clip)
