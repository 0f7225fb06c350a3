"""Unbounded space in a box (Mip-NeRF 360, arXiv:2111.12077, eq. 10)."""

from jaxtyping import Float
from torch import Tensor

from inpaint3d.radiance import safe


def contract(points: Float[Tensor, "*n 3"]) -> Float[Tensor, "*n 3"]:
    """Space into a ball of radius 2: the identity, exactly, inside the unit ball; (2 - 1/|x|) x/|x| outside."""
    length = safe.length(points)  # 1 inside the unit ball
    return points * ((2 - 1 / length) / length)


def unit_cube(points: Float[Tensor, "n 3"], contraction: bool, bound: float) -> Float[Tensor, "n 3"]:
    """Scene points to [0, 1]^3, where grids live: contracted, or the cube of half side `bound` as it is."""
    return (contract(points) / 2 + 1) / 2 if contraction else (points / bound + 1) / 2
