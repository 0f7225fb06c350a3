"""What a denoiser's output means, and exact conversions to the clean picture and to the noise.

With z = a x + s eps and a^2 + s^2 = 1 (a = alpha, s = sigma, per image):

    eps       the output is eps (arXiv:2006.11239)
    x0        the output is x
    v         the output is v = a eps - s x (arXiv:2202.00512)
    residual  x is taken as N(fill, d^2), d per opponent colour and band of a Haar transform, before the network says
              more; the output is what is left of x after the best linear guess, in units of its spread. EDM's
              preconditioning (arXiv:2206.00364, eq. 7), about the fill instead of about 0 and coloured instead of
              white. An output of 0 is then already the best guess from fill and z alone.

Only `eps` divides by a and only `x0` by s, which the schedule's clamp keeps above 4e-5.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.diffusion.bands import band_filter, from_opponent, to_opponent
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

Kind = Literal["eps", "v", "x0", "residual"]
Image = Float[Tensor, "b c h w"]


@dataclass(frozen=True, eq=False)
class Parameterisation:
    """A kind of output at the noise levels of one batch.

    bands, colours: d of `residual` is their product: the spread of lightness by band, finest first, and each opponent
    colour's share of it.
    """

    kind: Kind
    t: Float[Tensor, "b"]
    bands: tuple[float, ...] = ()
    colours: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def clean(self, output: Image, z: Image, fill: Image) -> Image:
        """x_hat, where z = a x_hat + s eps_hat."""
        a, s = self.levels
        if self.kind == "eps":
            return (z - s * output) / a
        if self.kind == "x0":
            return output
        if self.kind == "v":
            return a * z - s * output
        _, s_b, d, spread = self._by_band
        return self.linear_guess(z, fill) + _filter(output, s_b * d / spread)

    def noise(self, output: Image, z: Image, fill: Image) -> Image:
        """eps_hat, where z = a x_hat + s eps_hat."""
        a, s = self.levels
        if self.kind == "eps":
            return output
        if self.kind == "x0":
            return (z - a * output) / s
        if self.kind == "v":
            return s * z + a * output
        a_b, s_b, d, spread = self._by_band
        # (z - a x_hat) / s with the division by s carried out: nothing cancels as s falls to 0.
        return _filter(z - a * fill, s_b / spread**2) - _filter(output, a_b * d / spread)

    def target(self, x: Image, eps: Image, fill: Image) -> Image:
        """The output that names x and eps exactly: what the network is trained towards."""
        a, s = self.levels
        if self.kind == "eps":
            return eps
        if self.kind == "x0":
            return x
        if self.kind == "v":
            return a * eps - s * x
        a_b, s_b, d, spread = self._by_band
        return _filter(x - fill, s_b / (d * spread)) - _filter(eps, a_b * d / spread)

    def linear_guess(self, z: Image, fill: Image) -> Image:
        """E[x | z] if x were N(fill, d^2): the Wiener filter of z about the fill."""
        a, _ = self.levels
        a_b, _, d, spread = self._by_band
        return fill + _filter(z - a * fill, a_b * d**2 / spread**2)

    @property
    def levels(self) -> tuple[Float[Tensor, "b 1 1 1"], Float[Tensor, "b 1 1 1"]]:
        """(alpha, sigma), to multiply pictures by."""
        return per_image(alpha(self.t)), per_image(sigma(self.t))

    @property
    def _by_band(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """a, s [b, 1, 1], d [k, 3], and the spread of z about a fill, sqrt(a^2 d^2 + s^2) [b, k, 3]."""
        a, s = alpha(self.t)[:, None, None], sigma(self.t)[:, None, None]
        d = torch.outer(torch.tensor(self.bands), torch.tensor(self.colours)).to(a)
        return a, s, d, (a**2 * d**2 + s**2).sqrt()


def _filter(x: Float[Tensor, "b 3 h w"], gains: Float[Tensor, "b k 3"]) -> Float[Tensor, "b 3 h w"]:
    """RGB pictures with a gain for each band and opponent colour."""
    return from_opponent(band_filter(to_opponent(x), gains))
