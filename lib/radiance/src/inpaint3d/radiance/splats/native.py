"""`reference` on the compiled CPU kernels, a tile at a time. Results do not depend on the number of threads.

Importing this module raises ImportError where the kernels are not installed.
"""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d import kernels
from inpaint3d.radiance.splats import reference
from inpaint3d.radiance.splats.model import NEAR, Splats, View


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, view: View, *tensors: Tensor) -> Tensor:
        tensors = tuple(tensor.contiguous() for tensor in tensors)
        rgb = torch.empty(view.height, view.width, 3)
        kernels.splats_forward(_to_arrays(tensors), _describe(view), rgb.numpy(), threads=torch.get_num_threads())
        ctx.view = view
        ctx.save_for_backward(rgb, *tensors)
        return rgb

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        rgb, *tensors = ctx.saved_tensors
        grads = [torch.empty_like(tensor) for tensor in tensors]
        kernels.splats_backward(
            _to_arrays(tensors),
            _describe(ctx.view),
            rgb.numpy(),
            grad_outputs[0].contiguous().numpy(),
            _to_arrays(grads),
            threads=torch.get_num_threads(),
        )
        return None, *grads


def _to_arrays(tensors: Any) -> kernels.Splats:
    return kernels.Splats(*(tensor.detach().numpy() for tensor in tensors))


def _describe(view: View) -> kernels.Pinhole:
    return kernels.Pinhole(view.intrinsics, view.cam_from_world.numpy(), NEAR)


def render_splats(splats: Splats, view: View) -> Float[Tensor, "h w 3"]:
    """`reference.render_splats`; anything but float32 on the CPU goes there."""
    if not all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in splats.tensors):
        return reference.render_splats(splats, view)
    return _Render.apply(view, *splats.tensors)
