"""Noise schedules in log signal-to-noise form (Kingma et al., Variational Diffusion Models, arXiv:2107.00630).

z_t = alpha(t) x + sigma(t) eps with alpha^2 + sigma^2 = 1, so that one number, log(alpha^2 / sigma^2), says it all.
t runs from 0 (the picture) to 1 (noise).
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

CLAMP = 20.0
"""Bound of |log SNR| (D10): sigma never falls under 4.5e-5, alpha neither, so that both can be divided by."""


def cosine_log_snr(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """-2 log tan(pi t / 2), clamped to [-clamp, clamp] (cosine schedule, arXiv:2102.09672; D10)."""
    # Clamp t, not only the result: at t = 0 and t = 1 the logarithm is infinite and its gradient NaN.
    edge = math.atan(math.exp(-clamp / 2)) * 2 / math.pi
    angle = t.clamp(edge, 1 - edge) * (math.pi / 2)
    return (2 * (torch.log(torch.cos(angle)) - torch.log(torch.sin(angle)))).clamp(-clamp, clamp)


def alpha(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """Share of the picture in z_t: cos(pi t / 2) inside the clamp."""
    return torch.sqrt(torch.sigmoid(cosine_log_snr(t, clamp)))


def sigma(t: Float[Tensor, "*b"], clamp: float = CLAMP) -> Float[Tensor, "*b"]:
    """Standard deviation of the noise in z_t: sin(pi t / 2) inside the clamp."""
    return torch.sqrt(torch.sigmoid(-cosine_log_snr(t, clamp)))


def per_image(values: Float[Tensor, "b"]) -> Float[Tensor, "b 1 1 1"]:
    """One number per image, shaped to multiply a batch of images."""
    return values[:, None, None, None]
