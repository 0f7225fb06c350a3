"""The operations of `reference` on the compiled CPU kernels: same names, same signatures, same results to rounding.

The kernels take float32 tensors on the CPU; anything else (float64, another device, a gradient that only the reference
has) goes to `reference`, unchanged. Inputs that are not contiguous are copied. Threads are torch's
(`torch.get_num_threads()`), and results do not depend on their number. Importing this module raises ImportError where
the kernels are not installed.
"""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d import kernels
from inpaint3d.radiance.architecture import Level
from inpaint3d.radiance.backends import reference
from inpaint3d.radiance.backends.reference import AdamStep, Cells
from inpaint3d.radiance.memory import GradientMemory

__all__ = [
    "adam_step", "colours", "composite", "grid_histogram", "grid_learn", "hash_encode", "interlevel", "mlp", "resample",
    "unit_cube",
]  # fmt: skip


def are_supported(*tensors: Tensor) -> bool:
    """True where all tensors are of the kind that the kernels take."""
    return all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in tensors)


def _to_arrays(tensors: Sequence[Tensor | None]) -> list[Any]:
    return [None if tensor is None else tensor.numpy() for tensor in tensors]


class _HashEncode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, levels: Sequence[Level]) -> Tensor:
        ctx.levels, ctx.table = levels, table  # the table itself: its gradient's memory is known by it
        points, table = points.contiguous(), table.contiguous()
        ctx.save_for_backward(points)
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
        table_grad = _allocate_gradient(ctx.table, ctx.levels)
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
    if wants_points or table.shape[1] > 8 or not are_supported(points, table):
        return reference.hash_encode(points, table, levels)
    return _HashEncode.apply(points.detach(), table, levels)


_gradients = GradientMemory()


def _allocate_gradient(table: Tensor, levels: Sequence[Level]) -> Tensor:
    """Memory for a table's gradient; zero where no level will write."""
    grad = _gradients.take(table)
    return grad if sum(level.size for level in levels) == len(table) else grad.zero_()


class _Mlp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, starts: Tensor | None, *weights: Tensor) -> Tensor:
        x, weights = x.contiguous(), tuple(tensor.contiguous() for tensor in weights)
        starts = None if starts is None else starts.contiguous()
        ctx.save_for_backward(x, starts, *weights)
        out = x.new_empty(x.shape[0], weights[-1].shape[0])
        kernels.mlp_forward(_describe_network(x, starts, weights), out.numpy(), threads=torch.get_num_threads())
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        x, starts, *weights = ctx.saved_tensors
        grads = [torch.empty_like(weight) for weight in weights]
        x_grad = torch.empty_like(x) if ctx.needs_input_grad[0] else None
        starts_grad = None if starts is None else torch.empty_like(starts)
        kernels.mlp_backward(
            _describe_network(x, starts, weights),
            grad_outputs[0].contiguous().numpy(),
            _describe_network(x_grad, starts_grad, grads),
            threads=torch.get_num_threads(),
        )
        return x_grad, starts_grad, *grads


def _describe_network(x: Tensor | None, starts: Tensor | None, weights: Sequence[Tensor]) -> kernels.Network:
    x_array, starts_array = _to_arrays((x, starts))
    return kernels.Network(x_array, [weight.numpy() for weight in weights], starts_array)


def mlp(
    x: Float[Tensor, "n i"],
    weights: Sequence[Float[Tensor, "_ _"]],
    starts: Float[Tensor, "m {weights[0].shape[0]}"] | None = None,
) -> Float[Tensor, "n {weights[-1].shape[0]}"]:
    """`reference.mlp`; hidden activations are computed again in the backward pass, not kept. Long runs go there."""
    tensors = (*weights, *(() if starts is None else (starts,)))
    long = starts is not None and len(x) > kernels.MOST_RUN * len(starts)
    if not weights or long or not are_supported(x, *tensors):
        return reference.mlp(x, weights, starts)
    return _Mlp.apply(x, starts, *weights)


class _Colours(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, diffuse: Tensor, specular: Tensor | None, exposure: Tensor | None, scale: float
    ) -> tuple[Tensor, ...]:
        given = [None if t is None else t.contiguous() for t in (diffuse, specular, exposure)]
        ctx.save_for_backward(*given)
        ctx.scale = scale
        ctx.set_materialize_grads(False)
        outs = (diffuse.new_empty(diffuse.shape), diffuse.new_empty(diffuse.shape))
        out = kernels.Colours(*_to_arrays(outs))
        kernels.colours_forward(
            kernels.Logits(*_to_arrays(given)), _describe_colour_map(scale), out, threads=torch.get_num_threads()
        )
        return outs

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        given = ctx.saved_tensors
        out_grads = [None if grad is None else grad.contiguous() for grad in grad_outputs]
        grads = [None if tensor is None else torch.empty_like(tensor) for tensor in given]
        kernels.colours_backward(
            kernels.Logits(*_to_arrays(given)),
            _describe_colour_map(ctx.scale),
            kernels.Colours(*_to_arrays(out_grads)),
            kernels.Logits(*_to_arrays(grads)),
            threads=torch.get_num_threads(),
        )
        return *grads, None


def _describe_colour_map(scale: float) -> kernels.ColourMap:
    return kernels.ColourMap(scale, reference.COLOUR_PADDING)


def colours(
    diffuse: Float[Tensor, "n 3"],
    specular: Float[Tensor, "n 3"] | None,
    exposure: Float[Tensor, "m 6"] | None,
    specular_scale: float = 1.0,
) -> tuple[Float[Tensor, "n 3"], Float[Tensor, "n 3"]]:
    """`reference.colours`."""
    if not are_supported(*(tensor for tensor in (diffuse, specular, exposure) if tensor is not None)):
        return reference.colours(diffuse, specular, exposure, specular_scale)
    return _Colours.apply(diffuse, specular, exposure, specular_scale)


@torch.no_grad()
def grid_histogram(
    cells: Cells,
    origins: Float[Tensor, "r 3"],
    directions: Float[Tensor, "r 3"],
    tdist: Float[Tensor, " ends"],
    floor: float,
) -> Float[Tensor, "r ends-1"]:
    """`reference.grid_histogram`."""
    tensors = [tensor.detach().contiguous() for tensor in (cells.density, origins, directions, tdist)]
    if not are_supported(*tensors):
        return reference.grid_histogram(cells, origins, directions, tdist, floor)
    density, *rays = (tensor.numpy() for tensor in tensors)
    out = tdist.new_empty(len(origins), len(tdist) - 1)
    # Inside a tuple the binding takes no number that float32 does not hold exactly.
    bound = None if cells.contraction else tdist.new_tensor(cells.bound).item()
    kernels.grid_histogram(
        kernels.Cells(density, cells.side, bound),
        kernels.Rays(*rays),
        floor,
        out.numpy(),
        threads=torch.get_num_threads(),
    )
    return out


@torch.no_grad()
def grid_learn(
    density: Float[Tensor, " cells"],
    side: int,
    cube: Float[Tensor, "n 3"],
    seen: Float[Tensor, " n"],
    memory: float,
) -> None:
    """`reference.grid_learn`; a density that is not contiguous goes there."""
    if not are_supported(density, cube, seen) or not density.is_contiguous():
        reference.grid_learn(density, side, cube, seen, memory)
        return
    cube, seen = (tensor.detach().contiguous() for tensor in (cube, seen))
    kernels.grid_learn(density.detach().numpy(), side, cube.numpy(), seen.numpy(), memory)


class _Composite(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, density: Tensor, rgb: Tensor, tdist: Tensor) -> tuple[Tensor, ...]:
        density, rgb, tdist = density.contiguous(), rgb.contiguous(), tdist.contiguous()
        rays = density.shape[0]
        outs = (torch.empty_like(density), rgb.new_empty(rays, 3), rgb.new_empty(rays), rgb.new_empty(rays))
        samples = kernels.Samples(density.numpy(), rgb.numpy(), tdist.numpy())
        kernels.composite_forward(samples, kernels.Rendered(*_to_arrays(outs)), threads=torch.get_num_threads())
        ctx.save_for_backward(density, rgb, tdist, outs[0])
        return outs

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor, Tensor, None]:
        density, rgb, tdist, weights = ctx.saved_tensors
        grads = (torch.empty_like(density), torch.empty_like(rgb))
        kernels.composite_backward(
            kernels.Samples(density.numpy(), rgb.numpy(), tdist.numpy()),
            weights.numpy(),
            kernels.Rendered(*(grad.contiguous().numpy() for grad in grad_outputs)),
            kernels.SampleGradients(*_to_arrays(grads)),
            threads=torch.get_num_threads(),
        )
        return *grads, None


def composite(
    density: Float[Tensor, "r s"], rgb: Float[Tensor, "r s 3"], tdist: Float[Tensor, "r s+1"]
) -> tuple[Float[Tensor, "r s"], Float[Tensor, "r 3"], Float[Tensor, " r"], Float[Tensor, " r"]]:
    """`reference.composite`; a tdist that wants a gradient goes there."""
    wants_tdist = torch.is_grad_enabled() and tdist.requires_grad
    if wants_tdist or not are_supported(density, rgb, tdist):
        return reference.composite(density, rgb, tdist)
    return _Composite.apply(density, rgb, tdist.detach())


@torch.no_grad()
def resample(
    sdist: Float[Tensor, "r ends"],
    weights: Float[Tensor, "r ends-1"],
    count: int,
    jitter: Float[Tensor, "r {count}"] | None = None,
) -> Float[Tensor, "r {count}+1"]:
    """`reference.resample`."""
    arrays = [tensor.detach().contiguous() for tensor in (sdist, weights, *(() if jitter is None else (jitter,)))]
    if count < 2 or not are_supported(*arrays):
        return reference.resample(sdist, weights, count, jitter)
    out = sdist.new_empty(sdist.shape[0], count + 1)
    sdist, weights = arrays[:2]
    kernels.resample(
        sdist.numpy(),
        weights.numpy(),
        None if jitter is None else arrays[2].numpy(),
        out.numpy(),
        threads=torch.get_num_threads(),
    )
    return out


def unit_cube(points: Float[Tensor, "n 3"], contraction: bool, bound: float) -> Float[Tensor, "n 3"]:
    """`reference.unit_cube`; no contraction, and points that want a gradient, go there."""
    wants_points = torch.is_grad_enabled() and points.requires_grad
    if not contraction or wants_points or not are_supported(points):
        return reference.unit_cube(points, contraction, bound)
    points = points.detach().contiguous()
    out = torch.empty_like(points)
    kernels.unit_cube(points.numpy(), out.numpy(), threads=torch.get_num_threads())
    return out


class _Interlevel(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *histograms: Tensor) -> Tensor:
        histograms = tuple(tensor.contiguous() for tensor in histograms)
        ctx.save_for_backward(*histograms)
        out = histograms[0].new_empty(len(histograms[0]))
        kernels.interlevel_forward(*_describe_histograms(histograms), out.numpy(), threads=torch.get_num_threads())
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[None, None, None, Tensor]:
        saved = ctx.saved_tensors
        grad, out_grad = torch.empty_like(saved[3]), grad_outputs[0].contiguous()
        kernels.interlevel_backward(
            *_describe_histograms(saved), out_grad.numpy(), grad.numpy(), threads=torch.get_num_threads()
        )
        return None, None, None, grad


def _describe_histograms(tensors: Sequence[Tensor]) -> tuple[kernels.Histogram, kernels.Histogram]:
    ends, weights, other_ends, other_weights = _to_arrays(tensors)
    return kernels.Histogram(ends, weights), kernels.Histogram(other_ends, other_weights)


def interlevel(
    ends: Float[Tensor, "r n"],
    weights: Float[Tensor, "r n-1"],
    other_ends: Float[Tensor, "r m"],
    other_weights: Float[Tensor, "r m-1"],
) -> Float[Tensor, " r"]:
    """`reference.interlevel`."""
    if not are_supported(ends, weights, other_ends, other_weights):
        return reference.interlevel(ends, weights, other_ends, other_weights)
    return _Interlevel.apply(ends.detach(), weights.detach(), other_ends.detach(), other_weights)


@torch.no_grad()
def adam_step(
    param: Float[Tensor, "*shape"],
    grad: Float[Tensor, "*shape"],
    m: Float[Tensor, "*shape"],
    v: Float[Tensor, "*shape"],
    how: AdamStep,
) -> int | Tensor:
    """`reference.adam_step` in one pass; denormal moments become zero.

    param, m and v that are not contiguous go to the reference.
    """
    in_place = (param, m, v)
    if not are_supported(grad, *in_place) or not all(tensor.is_contiguous() for tensor in in_place):
        return reference.adam_step(param, grad, m, v, how)
    return kernels.adam(
        param.detach().view(-1).numpy(),
        grad.detach().contiguous().view(-1).numpy(),
        m.view(-1).numpy(),
        v.view(-1).numpy(),
        how,
        threads=torch.get_num_threads(),
    )
