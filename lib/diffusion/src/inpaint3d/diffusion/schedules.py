"""Noise schedules in log signal-to-noise form (Kingma et al., Variational Diffusion Models, arXiv:2107.00630).

z_t = alpha(t) x + sigma(t) eps with alpha^2 + sigma^2 = 1, so that one number, log(alpha^2 / sigma^2), says it all.
t runs from 0 (the picture) to 1 (noise).
"""

import math
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

Schedule = Literal["cosine", "linear", "shifted"]

CLAMP = 20.0
"""Bound of |log SNR| (D10): sigma never falls under 4.5e-5, alpha neither, so that both can be divided by."""


def cosine_log_snr(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """-2 log tan(pi t / 2), clamped to [-clamp, clamp] (cosine schedule, arXiv:2102.09672; D10)."""
    # Clamp t, not only the result: at t = 0 and t = 1 the logarithm is infinite and its gradient NaN.
    edge = math.atan(math.exp(-clamp / 2)) * 2 / math.pi
    angle = t.clamp(edge, 1 - edge) * (math.pi / 2)
    return (2 * (torch.log(torch.cos(angle)) - torch.log(torch.sin(angle)))).clamp(-clamp, clamp)


def linear_log_snr(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """-log(expm1(0.1 t + 9.95 t^2)), clamped: DDPM's linear betas in continuous time (arXiv:2011.13456, eq. 33)."""
    # As above; the smaller root of 0.1 t + 9.95 t^2 = log1p(exp(-clamp)) is where the clamp begins.
    floor = math.log1p(math.exp(-clamp))
    edge = 2 * floor / (0.1 + math.sqrt(0.01 + 4 * 9.95 * floor))
    t = t.clamp(edge, 1.0)
    return (-torch.log(torch.expm1(0.1 * t + 9.95 * t**2))).clamp(-clamp, clamp)


def shifted_log_snr(t: Float[Tensor, "*b"], size: int, clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """The cosine schedule moved by 2 log(64 / size), clamped (simple diffusion, arXiv:2301.11093, section 3.1).

    Averages over blocks of a `size` pixel picture are then as noisy as pixels of a 64 pixel one.
    """
    return (cosine_log_snr(t, clamp) + 2 * math.log(64 / size)).clamp(-clamp, clamp)


def cosine_time(log_snr: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The t at which the cosine schedule has this log SNR: the inverse of `cosine_log_snr` inside its clamp."""
    return torch.atan(torch.exp(-log_snr / 2)) * (2 / math.pi)


def cosine_time_of(t: Float[Tensor, "*b"], schedule: Schedule, size: int) -> Float[Tensor, "*b"]:
    """The time of the cosine schedule at which it is as noisy as `schedule` is at t.

    z_t and the network know of t by its log SNR alone, so that a schedule is no more than how often each noise level is
    visited: everything else reckons in the cosine schedule's time. size: of the pictures, pixels; for `shifted`.
    """
    if schedule == "linear":
        return cosine_time(linear_log_snr(t))
    if schedule == "shifted":
        return cosine_time(shifted_log_snr(t, size))
    return t


def alpha(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """Share of the picture in z_t: cos(pi t / 2) inside the clamp."""
    return torch.sqrt(torch.sigmoid(cosine_log_snr(t, clamp)))


def sigma(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """Standard deviation of the noise in z_t: sin(pi t / 2) inside the clamp."""
    return torch.sqrt(torch.sigmoid(-cosine_log_snr(t, clamp)))


def per_image(values: Float[Tensor, "b"]) -> Float[Tensor, "b 1 1 1"]:
    """One number per image, shaped to multiply a batch of images."""
    return values[:, None, None, None]
