"""Distances along a ray: metric t in scene units, normalised s in [0, 1]."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor


class Spacing(NamedTuple):
    """How samples spread from near to far: evenly in t/(1 + t) where `reciprocal`, else evenly in t.

    Mip-NeRF 360 (arXiv:2111.12077, eq. 11) spaces evenly in 1/t, which spends half of the samples before 2 near.
    Cameras lie in the unit ball, so that 1/(1 + t) is even in depth up to about 1 and in disparity beyond.
    """

    near: float
    far: float
    reciprocal: bool

    def metric_from_normalised(self, sdist: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
        """Scene units from [0, 1]."""
        if not self.reciprocal:
            return self.near + sdist * (self.far - self.near)
        # Both shares are added, not one subtracted: exact at s = 1 too, where 1/(1 + t) is small.
        return 1 / ((1 - sdist) / (1 + self.near) + sdist / (1 + self.far)) - 1


def below_limit(x: Float[Tensor, "*n"], p: float, premult: float = 1.0) -> Float[Tensor, "*n"]:
    """How much the ladder P(x, p) of Zip-NeRF (arXiv:2304.06706, supplement) lacks to its limit, for x >= 0.

    P(x, p) is about x near 0 and tends to (p - 1)/p. Near the limit float32 forgets the differences of P: with premult
    20000 all distances beyond 1000 are one. This difference keeps them, and has the same distances up to sign.
    """
    if p >= 0:
        raise ValueError(f"the ladder has a limit only for p < 0, not {p}")
    return (p - 1) / p * (premult * x / (1 - p) + 1) ** p
