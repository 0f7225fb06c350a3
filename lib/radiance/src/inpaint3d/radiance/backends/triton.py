"""The operations of `reference` on GPUs: hash grids, networks and Adam by Triton's kernels, the rest compiled.

The kernels take float32 tensors on a GPU (or on a processor under TRITON_INTERPRET=1, which is how they are tested
there); what they do not take goes to `compiled`. Matrix products are split in three of TF32, whose error is that of
float32; those of a network's backward pass are one of TF32 (2^-11 of each product), since more would not fit into
registers. Importing this module raises ImportError where Triton is not installed; it comes with torch for CUDA.
"""
# Triton is not where the types are checked: its kernels look like plain functions there.
# pyright: reportMissingImports=false, reportIndexIssue=false

import os
from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
import triton
from jaxtyping import Float
from torch import Tensor

from inpaint3d.radiance.architecture import Level
from inpaint3d.radiance.backends import compiled, triton_kernels
from inpaint3d.radiance.backends.compiled import (
    can_compile,
    colours,
    composite,
    grid_histogram,
    grid_learn,
    interlevel,
    resample,
    unit_cube,
)
from inpaint3d.radiance.backends.reference import AdamStep

__all__ = [
    "adam_step", "can_compile", "colours", "composite", "grid_histogram", "grid_learn", "hash_encode", "interlevel",
    "mlp", "resample", "unit_cube",
]  # fmt: skip

INTERPRETED = os.environ.get("TRITON_INTERPRET") == "1"
POINTS, ROWS, NUMBERS = 256, 64, 1024
"""Points, rows and numbers of a program of the kernels of grids, networks and Adam."""
SMALLEST, WIDEST = 16, 128
"""Sides of the matrices that the units multiply."""
PROGRAMS = 8
"""Of a backward pass of networks, for each multiprocessor: each adds its weights' gradient up once."""


def are_supported(*tensors: Tensor) -> bool:
    """True where all tensors are of the kind that the kernels take."""
    return all(tensor.dtype == torch.float32 and (INTERPRETED or tensor.is_cuda) for tensor in tensors)


class _HashEncode(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, points: Tensor, table: Tensor, levels: tuple[Level, ...]) -> Tensor:
        points, table = points.contiguous(), table.contiguous()
        ctx.levels, ctx.table = levels, table.shape
        ctx.save_for_backward(points)
        out = points.new_empty(len(points), len(levels) * table.shape[1])
        if len(points):
            layout = _make_layout(levels, points.device)
            sizes = {"LEVELS": len(levels), "CHANNELS": table.shape[1], "BLOCK": POINTS}
            grid = (triton.cdiv(len(points), POINTS), len(levels))
            triton_kernels.hash_forward[grid](points, table, layout, out, len(points), **sizes)
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[None, Tensor, None]:
        (points,) = ctx.saved_tensors
        table_grad = points.new_zeros(ctx.table)
        if len(points):
            layout = _make_layout(ctx.levels, points.device)
            sizes = {"LEVELS": len(ctx.levels), "CHANNELS": ctx.table[1], "BLOCK": POINTS}
            grid = (triton.cdiv(len(points), POINTS), len(ctx.levels))
            out_grad = grad_outputs[0].contiguous()
            triton_kernels.hash_backward[grid](points, out_grad, layout, table_grad, len(points), **sizes)
        return None, table_grad, None


@cache
def _make_layout(levels: tuple[Level, ...], device: torch.device) -> Tensor:
    return torch.tensor([[int(number) for number in level] for level in levels], dtype=torch.int32, device=device)


def hash_encode(
    points: Float[Tensor, "n 3"], table: Float[Tensor, "entries c"], levels: Sequence[Level]
) -> Float[Tensor, "n {len(levels)}*c"]:
    """`reference.hash_encode`; channels that are not 1, 2, 4 or 8, and points that want a gradient, are compiled."""
    wants_points = torch.is_grad_enabled() and points.requires_grad
    if wants_points or table.shape[1] not in (1, 2, 4, 8) or not are_supported(points, table):
        return compiled.hash_encode(points, table, levels)
    encoded: Any = _HashEncode.apply(points.detach(), table, tuple(levels))
    return encoded


class _Mlp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor, starts: Tensor | None, *weights: Tensor) -> Tensor:
        x, weights = x.contiguous(), tuple(tensor.contiguous() for tensor in weights)
        starts = None if starts is None else starts.contiguous()
        ctx.save_for_backward(x, starts, *weights)
        out = x.new_empty(len(x), len(weights[-1]))
        if len(x):
            grid = (triton.cdiv(len(x), ROWS),)
            triton_kernels.mlp_forward[grid](
                x, *_take_three(weights), x if starts is None else starts, out, len(x), _run(x, starts),
                PRECISION="tf32x3", **_measure_sizes(weights, starts),
            )  # fmt: skip
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride] (the decorator hides the names)
        ctx: Any, *grad_outputs: Tensor
    ) -> tuple[Tensor | None, ...]:
        x, starts, *weights = ctx.saved_tensors
        x_grad, grads = torch.empty_like(x), [torch.zeros_like(weight) for weight in weights]
        starts_grad = None if starts is None else torch.zeros_like(starts)
        if len(x):
            grid = (min(triton.cdiv(len(x), ROWS), PROGRAMS * _count_multiprocessors(x.device)),)
            triton_kernels.mlp_backward[grid](
                x, *_take_three(weights), x if starts is None else starts, grad_outputs[0].contiguous(),
                x_grad, *_take_three(grads), x if starts_grad is None else starts_grad, len(x), _run(x, starts),
                PRECISION="tf32", num_warps=8, **_measure_sizes(weights, starts),
            )  # fmt: skip
        return x_grad, starts_grad, *grads


def _take_three(layers: Sequence[Tensor]) -> tuple[Tensor, Tensor, Tensor]:
    """First, middle and last; a network of two has no middle, and what stands in for it is not looked at."""
    return layers[0], layers[1], layers[-1]


def _run(x: Tensor, starts: Tensor | None) -> int:
    return 1 if starts is None else len(x) // max(len(starts), 1)


def _measure_sizes(weights: Sequence[Tensor], starts: Tensor | None) -> dict[str, Any]:
    widths = {"IN": weights[0].shape[1], "HIDDEN": weights[0].shape[0], "OUT": weights[-1].shape[0]}
    own = {f"N_{name}": width for name, width in widths.items()}
    padded = {f"P_{name}": max(SMALLEST, triton.next_power_of_2(width)) for name, width in widths.items()}
    form = {"DEEP": len(weights) == 3, "STARTS": starts is not None, "BLOCK": ROWS}
    return own | padded | form


@cache
def _count_multiprocessors(device: torch.device) -> int:
    return torch.cuda.get_device_properties(device).multi_processor_count if device.type == "cuda" else 1


def mlp(
    x: Float[Tensor, "n i"],
    weights: Sequence[Float[Tensor, "_ _"]],
    starts: Float[Tensor, "m {weights[0].shape[0]}"] | None = None,
) -> Float[Tensor, "n {weights[-1].shape[0]}"]:
    """`reference.mlp`; hidden activations are computed again in the backward pass, not kept.

    Other networks than of two or three layers, of at most 128 numbers each and with one hidden width, are compiled.
    """
    fits = len(weights) in (2, 3) and max(max(weight.shape) for weight in weights) <= WIDEST
    fits = fits and (len(weights) == 2 or weights[1].shape[0] == weights[1].shape[1])
    if not fits or not are_supported(x, *weights, *(() if starts is None else (starts,))):
        return compiled.mlp(x, weights, starts)
    made: Any = _Mlp.apply(x, starts, *weights)
    return made


@torch.no_grad()
def adam_step(
    param: Float[Tensor, "*shape"],
    grad: Float[Tensor, "*shape"],
    m: Float[Tensor, "*shape"],
    v: Float[Tensor, "*shape"],
    how: AdamStep,
) -> int | Tensor:
    """`reference.adam_step` in one pass. param, m and v that are not contiguous go there."""
    in_place = (param, m, v)
    if not are_supported(grad, *in_place) or not all(tensor.is_contiguous() for tensor in in_place):
        return compiled.adam_step(param, grad, m, v, how)
    lost = torch.zeros((), dtype=torch.int32, device=param.device)
    if param.numel():
        step_size, unbias = how.lr / (1 - how.beta1**how.step), 1 / (1 - how.beta2**how.step)
        triton_kernels.adam[(triton.cdiv(param.numel(), NUMBERS),)](
            param, grad.contiguous(), m, v, lost, param.numel(), step_size, how.beta1, how.beta2, unbias, how.eps,
            how.decay, SPARSE=how.sparse, BLOCK=NUMBERS,
        )  # fmt: skip
    return lost
