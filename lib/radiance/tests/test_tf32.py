"""What TF32 does to the backward pass of networks on GPUs, imitated on the processor: the units cut 13 bits off."""

import importlib.util
from itertools import pairwise
from pathlib import Path
from types import ModuleType

import pytest
import torch
from torch import Tensor

WIDTHS, ROWS = (32, 64, 1), 150


@pytest.fixture(scope="module")
def triton_run() -> ModuleType:
    spec = importlib.util.spec_from_file_location("triton_run", Path(__file__).with_name("triton_run.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cut(numbers: Tensor) -> Tensor:
    """As TF32 by truncation, in float64."""
    return (numbers.contiguous().view(torch.int32) & ~0x1FFF).view(torch.float32).double()


def product(a: Tensor, b: Tensor) -> Tensor:
    return (cut(a) @ cut(b)).float()


def backwards(rows: Tensor, weights: list[Tensor], grad: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients by the rows of a network of two layers: true, in TF32; and which rows have a unit that flips."""
    first, last = weights
    sums, seen = rows.double() @ first.double().T, product(rows, first.T)
    true = ((grad.double() @ last.double()) * (sums > 0)) @ first.double()
    down = torch.where(seen > 0, product(grad, last), 0.0)
    return true, product(down, first).double(), ((sums > 0) != (seen > 0)).any(1)


def is_off(made: Tensor, true: Tensor, allowed: float) -> Tensor:
    scale = true.abs().max().clamp(min=1.0)
    return ((made - true) / scale).abs() > allowed * (1 + (true / scale).abs())


def test_a_gradient_in_tf32_is_off_where_a_unit_flips_and_nowhere_else(triton_run: ModuleType) -> None:
    """The numbers that an H200 had wrong (docs/how-to/use-a-gpu.md): 155, in seven rows."""
    allowed = triton_run.CLOSE_TF32["atol"]
    chance = torch.Generator().manual_seed(0)
    for widths in ((40, 64, 19), WIDTHS):  # as `triton_run` drew them
        weights = [torch.randn(o, i, generator=chance) / i**0.5 for i, o in pairwise(widths)]
        rows = torch.randn(ROWS, widths[0], generator=chance)
        grad = torch.randn(ROWS, widths[-1], generator=chance)
    true, made, flips = backwards(rows, weights, grad)
    off = is_off(made, true, allowed)
    assert int(off.sum()) == 155
    assert int(flips.sum()) == 7
    assert torch.equal(off.any(1), flips)


def test_rows_away_from_kinks_are_within_what_is_allowed(triton_run: ModuleType) -> None:
    chance = torch.Generator().manual_seed(1)
    weights = [torch.randn(o, i, generator=chance) / i**0.5 for i, o in pairwise(WIDTHS)]
    rows = triton_run.draw_rows(ROWS, weights, [], chance)
    true, made, flips = backwards(rows, weights, torch.randn(ROWS, WIDTHS[-1], generator=chance))
    assert not flips.any()
    assert not is_off(made, true, triton_run.CLOSE_TF32["atol"]).any()
