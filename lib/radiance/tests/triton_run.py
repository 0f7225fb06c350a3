"""The kernels for GPUs against the reference, forward and backward.

TRITON_INTERPRET=1 python lib/radiance/tests/triton_run.py     # interpreted, on a processor
python lib/radiance/tests/triton_run.py cuda                   # on a GPU; `benchmarks/gpu` does so too
"""

import sys
from collections.abc import Callable, Sequence
from itertools import pairwise

import torch
from torch import Tensor

from inpaint3d.radiance.architecture import levels_of
from inpaint3d.radiance.backends import Backend, reference, select
from inpaint3d.radiance.backends.reference import AdamStep

COMPARED = ("hash_encode", "mlp", "adam")
# Sums of float32 in another order; tf32x3 leaves 2^-22 or so of each product, tf32 (networks backwards) 2^-11. Triton's
# interpreter multiplies in float32.
CLOSE = {"rtol": 2e-5, "atol": 2e-5}
CLOSE_TF32 = {"rtol": 2e-3, "atol": 2e-3}
KINK = 1e-2
"""Of a rectifier: so near to 0, what TF32 leaves of a sum decides whether the backward pass takes the unit for open."""


def compare_hash_encode(backend: Backend, device: str, chance: torch.Generator) -> None:
    """Dense levels and hashed ones, points on the cube's border and beyond it, each number of channels."""
    for channels in (1, 2, 4, 8):
        levels = levels_of(4, 3, 40, 9)
        points = torch.rand(700, 3, generator=chance) * 1.02 - 0.01
        points[:3] = torch.tensor([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.5, 1.0, 0.0]])
        table = torch.randn(levels[-1].offset + levels[-1].size, channels, generator=chance)
        _compare(
            lambda made, points=points, levels=levels: lambda t: made.hash_encode(points.to(t.device), t, levels),
            backend, device, [table], chance,
        )  # fmt: skip


def compare_mlp(backend: Backend, device: str, chance: torch.Generator) -> None:
    """Two and three layers, with and without starts, rows that fill no block, none of them at a rectifier's kink."""
    for widths, runs in (((40, 64, 19), 0), ((32, 64, 1), 0), ((15, 64, 64, 3), 0), ((15, 16, 16, 3), 6)):
        rows = 150
        weights = [torch.randn(o, i, generator=chance) / i**0.5 for i, o in pairwise(widths)]
        starts = [torch.randn(rows // runs, widths[1], generator=chance)] if runs else []
        given = [draw_rows(rows, weights, starts, chance), *weights, *starts]
        count = len(weights)
        _compare(
            lambda made, count=count: lambda x, *rest: made.mlp(x, list(rest[:count]), *rest[count:]),
            backend, device, given, chance, CLOSE if device == "cpu" else CLOSE_TF32,
        )  # fmt: skip


def draw_rows(count: int, weights: Sequence[Tensor], starts: Sequence[Tensor], chance: torch.Generator) -> Tensor:
    """Rows whose units are all further than KINK from opening or closing; each is drawn anew until it is one."""
    rows = torch.full((count, weights[0].shape[1]), torch.nan)
    lost = torch.ones(count, dtype=torch.bool)
    while bool(lost.any()):
        rows[lost] = torch.randn(int(lost.sum()), rows.shape[1], generator=chance)
        hidden, lost = rows, torch.zeros_like(lost)
        for i, weight in enumerate(weights[:-1]):
            sums = hidden @ weight.T
            if i == 0 and starts:
                sums = sums + starts[0].repeat_interleave(count // len(starts[0]), 0)
            lost |= (sums.abs() < KINK).any(1)
            hidden = sums.relu()
    return rows


def compare_adam(backend: Backend, device: str, chance: torch.Generator) -> None:
    """Steps dense and sparse, with gradients that are not finite."""
    for sparse in (False, True):
        state = [torch.randn(2000, generator=chance) for _ in range(3)] + [torch.rand(2000, generator=chance)]
        state[1][::3] = 0.0
        state[1][::97] = torch.nan
        state[1][5::97] = torch.inf
        state[1][7::97] = 1e30  # whose square overflows
        state[3][11::97] = torch.inf  # a moment that is broken already
        how = AdamStep(3, 1e-2, 0.9, 0.99, 1e-15, 0.01, sparse)
        here, there = [part.clone() for part in state], [part.to(device) for part in state]
        wanted, lost = reference.adam_step(*here, how), backend.adam_step(*there, how)
        assert int(lost) == int(wanted) > 0
        for made, truth in zip(there, here, strict=True):
            torch.testing.assert_close(made.cpu(), truth, equal_nan=True, **CLOSE)


def _compare(
    of: Callable[[Backend], Callable[..., Tensor]],
    backend: Backend,
    device: str,
    given: Sequence[Tensor],
    chance: torch.Generator,
    backwards: dict[str, float] = CLOSE,
) -> None:
    """Outputs and gradients of a function of the backend and of the reference on the processor, in float64 there."""
    truths = [part.double().requires_grad_() for part in given]
    wanted = of(reference)(*truths)
    weight = torch.randn(wanted.shape, generator=chance)
    parts = [part.to(device).requires_grad_() for part in given]
    made = of(backend)(*parts)
    gradients = torch.autograd.grad((made * weight.to(device)).sum(), parts)
    true_gradients = torch.autograd.grad((wanted * weight).sum(), truths)
    pairs = [(made, wanted, CLOSE), *((g, t, backwards) for g, t in zip(gradients, true_gradients, strict=True))]
    for one, truth, close in pairs:
        scale = float(truth.detach().abs().max().clamp(min=1.0))
        torch.testing.assert_close(one.detach().cpu() / scale, (truth.detach() / scale).float(), **close)


def compare(name: str, device: str) -> None:
    """One of COMPARED. Raises AssertionError where its kernel is not close."""
    globals()[f"compare_{name}"](select(device, "triton"), device, torch.Generator().manual_seed(0))


if __name__ == "__main__":
    for kernel in COMPARED:
        compare(kernel, sys.argv[1] if len(sys.argv) > 1 else "cpu")
        sys.stdout.write(f"{kernel}\n")
