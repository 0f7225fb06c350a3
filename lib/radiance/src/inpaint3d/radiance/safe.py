"""Maths whose plain form overflows, or whose gradient is NaN where its value is fine."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

# exp(15) = 3.3e6 per scene unit: a millionth of a unit is opaque already, and the gradient stays finite.
EXP_CEILING = 15.0


class _TruncatedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        value = torch.exp(x.clamp(max=EXP_CEILING))
        ctx.save_for_backward(value)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        (value,) = ctx.saved_tensors
        return grads[0] * value


def exp(x: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """e^min(x, 15) whose gradient is its value everywhere.

    The plain one overflows above 88; a clamped one has no gradient above the clamp, so that a density that is too high
    could never come down again.
    """
    result: Any = _TruncatedExp.apply(x)
    return result


def divide(
    above: Float[Tensor, "*n"], below: Float[Tensor, "*n"], otherwise: float, smallest: float
) -> Float[Tensor, "*n"]:
    """The quotient where below > smallest, else `otherwise` with no gradient.

    where(below > 0, above / below, 0) backpropagates 0 * inf = NaN from the branch that it rejects.
    """
    fine = below > smallest
    return torch.where(fine, above / torch.where(fine, below, 1), otherwise)


def length(x: Float[Tensor, "*n d"]) -> Float[Tensor, "*n 1"]:
    """Euclidean length, at least 1; the gradient is 0 inside the unit ball.

    sqrt(sum(x^2)) has a NaN gradient at 0 and overflows at 1e19 (in float32).
    """
    largest = x.detach().abs().amax(-1, keepdim=True).clamp(min=1)
    return largest * torch.sqrt((x / largest).square().sum(-1, keepdim=True).clamp(min=1 / largest.square()))
