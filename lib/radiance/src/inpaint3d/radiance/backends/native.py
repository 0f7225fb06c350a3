"""The operations of `reference` on the compiled CPU kernels: same names, same signatures, same results to rounding.

The kernels take float32 tensors on the CPU; anything else (float64, another device, points that want a gradient) goes
to `reference`, unchanged. Inputs that are not contiguous are copied. Threads are torch's (`torch.get_num_threads()`),
and results do not depend on their number. Importing this module raises ImportError where the kernels are not installed.
"""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d import kernels
from inpaint3d.radiance.backends import reference
from inpaint3d.radiance.backends.reference import Level, composite, levels_of, mlp, resample

__all__ = ["Level", "adam_step", "composite", "hash_encode", "levels_of", "mlp", "resample"]


def supported(*tensors: Tensor) -> bool:
    """True where all tensors are of the kind that the kernels take."""
    return all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in tensors)


class _HashEncode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, levels: Sequence[Level]) -> Tensor:
        points, table = points.contiguous(), table.contiguous()
        ctx.save_for_backward(points)
        ctx.levels, ctx.shape = levels, table.shape
        out = points.new_empty(points.shape[0], len(levels) * table.shape[1])
        kernels.hash_forward(points.numpy(), table.numpy(), levels, out.numpy(), threads=torch.get_num_threads())
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[None, Tensor, None]:
        (points,) = ctx.saved_tensors
        (out_grad,) = grad_outputs
        table_grad = out_grad.new_zeros(ctx.shape)
        kernels.hash_backward(
            points.numpy(),
            out_grad.contiguous().numpy(),
            ctx.levels,
            table_grad.numpy(),
            threads=torch.get_num_threads(),
        )
        return None, table_grad, None


def hash_encode(
    points: Float[Tensor, "n 3"], table: Float[Tensor, "entries c"], levels: Sequence[Level]
) -> Float[Tensor, "n {len(levels)}*c"]:
    """`reference.hash_encode`; more than 8 channels and points that want a gradient go there."""
    wants_points = torch.is_grad_enabled() and points.requires_grad
    if wants_points or table.shape[1] > 8 or not supported(points, table):
        return reference.hash_encode(points, table, levels)
    return _HashEncode.apply(points.detach(), table, levels)


@torch.no_grad()
def adam_step(
    param: Float[Tensor, "*shape"],
    grad: Float[Tensor, "*shape"],
    m: Float[Tensor, "*shape"],
    v: Float[Tensor, "*shape"],
    step: int,
    lr: float,
    beta1: float,
    beta2: float,
    eps: float,
) -> None:
    """`reference.adam_step` in one pass; denormal moments become zero.

    param, m and v that are not contiguous go to the reference.
    """
    in_place = (param, m, v)
    if not supported(grad, *in_place) or not all(tensor.is_contiguous() for tensor in in_place):
        reference.adam_step(param, grad, m, v, step, lr, beta1, beta2, eps)
        return
    kernels.adam(
        param.detach().view(-1).numpy(),
        grad.detach().contiguous().view(-1).numpy(),
        m.view(-1).numpy(),
        v.view(-1).numpy(),
        step=step,
        lr=lr,
        beta1=beta1,
        beta2=beta2,
        eps=eps,
        threads=torch.get_num_threads(),
    )
