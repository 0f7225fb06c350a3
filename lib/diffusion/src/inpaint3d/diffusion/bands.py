"""Filters that are diagonal in opponent colours and an orthonormal Haar transform: a gain for each colour and band.

Pictures differ from a smooth fill mostly in lightness and at coarse scales: on photos a Haar coefficient spreads about
twice as far from one band to the next, and colour a quarter as far as lightness. A denoiser that is told so need not
learn it.
"""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def to_opponent(x: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """RGB -> lightness, red against blue, green against both: a rotation, so that white noise stays white."""
    return torch.einsum("ij,bjhw->bihw", _make_opponent_matrix(x), x)


def from_opponent(x: Float[Tensor, "b 3 h w"]) -> Float[Tensor, "b 3 h w"]:
    """The inverse of `to_opponent`."""
    return torch.einsum("ji,bjhw->bihw", _make_opponent_matrix(x), x)


def _make_opponent_matrix(like: Tensor) -> Float[Tensor, "3 3"]:
    rows = torch.tensor([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [-1.0, 2.0, -1.0]]).to(like)
    return rows / rows.norm(dim=1, keepdim=True)


def band_filter(x: Float[Tensor, "b c h w"], gains: Float[Tensor, "b k c"]) -> Float[Tensor, "b c h w"]:
    """The pictures with band j multiplied by gains[:, j]; j = 0 is the finest, the last holds all that is coarser.

    With P_j the average over blocks of 2^j pixels, band j is (P_j - P_{j+1}) x and the last one P_{k-1} x: orthogonal
    projections that sum to the identity. Sides must be multiples of 2 ** (k - 1) (ValueError).
    """
    bands = gains.shape[1]
    block = 2 ** (bands - 1)
    if x.shape[-1] % block or x.shape[-2] % block:
        raise ValueError(f"pictures are {x.shape[-1]}x{x.shape[-2]}; {bands} bands need multiples of {block}")
    # sum_j g_j (P_j - P_{j+1}) = g_0 + sum_{j > 0} (g_j - g_{j-1}) P_j, summed from the coarsest up.
    steps = torch.diff(gains, dim=1)[..., None, None]
    means = [x]
    for _ in range(bands - 1):
        means.append(F.avg_pool2d(means[-1], 2))
    total = torch.zeros_like(means[-1])
    for j in range(bands - 1, 0, -1):
        total = F.interpolate(total + steps[:, j - 1] * means[j], scale_factor=2, mode="nearest")
    return gains[:, 0, :, None, None] * x + total


def pixel_variance(spreads: Sequence[float]) -> float:
    """Mean variance of a pixel whose Haar coefficients have these standard deviations by band."""
    last = len(spreads) - 1
    shares = [4.0**-j - (4.0 ** -(j + 1) if j < last else 0.0) for j in range(len(spreads))]
    return sum(share * spread**2 for share, spread in zip(shares, spreads, strict=True))
