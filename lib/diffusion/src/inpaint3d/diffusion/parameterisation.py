"""What a denoiser's output means, and exact conversions to the clean picture and to the noise.

With z = a x + s eps and a^2 + s^2 = 1 (a, s: alpha and sigma per image):

    eps       the output is eps (arXiv:2006.11239)
    x0        the output is x
    v         the output is v = a eps - s x (arXiv:2202.00512)
    residual  x is taken as N(fill, d^2) before the network says more; the output is what is left of x after the best
              linear guess, in units of its spread (EDM's preconditioning, arXiv:2206.00364 eq. 7, about the fill
              instead of about 0). An output of 0 is then already the best guess from the fill and z alone.

Guard: only `eps` divides by a and only `x0` divides by s, which the schedule's clamp keeps above 4e-5.
"""

from typing import Literal

from jaxtyping import Float
from torch import Tensor

Prediction = Literal["eps", "v", "x0", "residual"]
Image = Float[Tensor, "b 3 h w"]
Level = Float[Tensor, "b 1 1 1"]


def clean_from_output(kind: Prediction, output: Image, z: Image, a: Level, s: Level, fill: Image, d: float) -> Image:
    """x_hat."""
    if kind == "eps":
        return (z - s * output) / a
    if kind == "x0":
        return output
    if kind == "v":
        return a * z - s * output
    spread = _spread(a, s, d)
    return fill + a * d**2 / spread**2 * (z - a * fill) + s * d / spread * output


def noise_from_output(kind: Prediction, output: Image, z: Image, a: Level, s: Level, fill: Image, d: float) -> Image:
    """eps_hat, so that z = a x_hat + s eps_hat."""
    if kind == "eps":
        return output
    if kind == "x0":
        return (z - a * output) / s
    if kind == "v":
        return s * z + a * output
    spread = _spread(a, s, d)
    return s / spread**2 * (z - a * fill) - a * d / spread * output


def target_output(kind: Prediction, x: Image, eps: Image, a: Level, s: Level, fill: Image, d: float) -> Image:
    """The output that names x and eps exactly: what the network is trained towards."""
    if kind == "eps":
        return eps
    if kind == "x0":
        return x
    if kind == "v":
        return a * eps - s * x
    return (s / d * (x - fill) - a * d * eps) / _spread(a, s, d)


def _spread(a: Level, s: Level, d: float) -> Level:
    """Standard deviation of z about a * fill."""
    return (a**2 * d**2 + s**2).sqrt()
