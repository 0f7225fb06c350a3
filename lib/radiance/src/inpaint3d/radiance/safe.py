"""Maths whose plain form overflows, or whose gradient is NaN where its value is fine."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

# exp(15) = 3.3e6 per scene unit: a millionth of a unit is opaque already, and the gradient stays finite.
EXP_CEILING = 15.0
# The slope of a sigmoid at +-9.2, where it is a ten-thousandth from its end.
LEAST_SLOPE = 1e-4


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

    where(below > 0, above / below, 0) backpropagates 0 * inf = NaN from the branch that it rejects. A NaN is no small
    number: it stays NaN.
    """
    small = below <= smallest
    return torch.where(small, otherwise, above / torch.where(small, 1, below))


class _Sigmoid(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        value = torch.sigmoid(x)
        ctx.save_for_backward(value)
        return value

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        (value,) = ctx.saved_tensors
        return grads[0] * (value * (1 - value)).clamp(min=LEAST_SLOPE)


def sigmoid(x: Float[Tensor, "*n"]) -> Float[Tensor, "*n"]:
    """1 / (1 + e^-x), whose gradient is never less than a ten-thousandth of what comes in.

    The plain one's is 0 from x = 17 on (in float32), so that what has become white once could never be grey again.
    """
    result: Any = _Sigmoid.apply(x)
    return result


def length(x: Float[Tensor, "*n d"]) -> Float[Tensor, "*n 1"]:
    """Euclidean length, at least 1; the gradient is 0 inside the unit ball.

    sqrt(sum(x^2)) has a NaN gradient at 0 and overflows at 1e19 (in float32).
    """
    largest = x.detach().abs().amax(-1, keepdim=True).clamp(min=1)
    return largest * torch.sqrt((x / largest).square().sum(-1, keepdim=True).clamp(min=1 / largest.square()))
