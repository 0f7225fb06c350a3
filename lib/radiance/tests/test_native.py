"""The native backend against the reference computed in float64, forward and backward."""

import pytest
import torch

from inpaint3d.radiance.backends import OPERATIONS, reference, select

native = pytest.importorskip("inpaint3d.radiance.backends.native", exc_type=ImportError)
kernels = pytest.importorskip("inpaint3d.kernels", exc_type=ImportError)


@pytest.fixture(params=kernels.isas())
def isa(request):
    before = kernels.isa()
    kernels.set_isa(request.param)
    yield request.param
    kernels.set_isa(before)


@pytest.fixture(params=[1, 2])
def threads(request):
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


def normal(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def uniform(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed))


def test_the_native_backend_is_chosen_on_the_cpu_and_offers_every_operation():
    assert select("cpu") is native
    for name in OPERATIONS:
        assert callable(getattr(native, name))


# Below 2^7 every level hashes; at 2^15 all but the last are dense.
@pytest.mark.parametrize("log2_table", [3, 9, 15])
@pytest.mark.parametrize(("count", "channels"), [(1, 1), (333, 2), (65, 3), (200, 4), (64, 8)])
def test_hash_encode_equals_the_reference(isa, threads, log2_table, count, channels):
    levels = reference.levels_of(5, 4, 61, log2_table)
    points = uniform(count, 3)
    table = normal(levels[-1].offset + levels[-1].size, channels).requires_grad_()
    exact = table.detach().double().requires_grad_()
    out_grad = normal(count, 5 * channels, seed=1)

    out = native.hash_encode(points, table, levels)
    truth = reference.hash_encode(points.double(), exact, levels)
    out.backward(out_grad)
    truth.backward(out_grad.double())
    # A float32 position among 61 cells is known to 61 * 2^-24 = 4e-6 of a cell; table values reach 4.
    torch.testing.assert_close(out, truth.float(), atol=5e-5, rtol=0)
    scale = max(1.0, exact.grad.abs().max().item())
    torch.testing.assert_close(table.grad, exact.grad.float(), atol=2e-5 * scale, rtol=0)


def test_hash_encode_of_no_points(isa):
    levels = reference.levels_of(3, 4, 16, 9)
    table = normal(levels[-1].offset + levels[-1].size, 4).requires_grad_()
    out = native.hash_encode(torch.empty(0, 3), table, levels)
    assert out.shape == (0, 12)
    (grad,) = torch.autograd.grad(out.sum(), table)
    assert torch.equal(grad, torch.zeros_like(table))


def test_hash_encode_takes_views(isa):
    levels = reference.levels_of(3, 4, 16, 9)
    entries = levels[-1].offset + levels[-1].size
    points, table = uniform(3, 40).T, normal(2, entries).T.requires_grad_()
    out = native.hash_encode(points, table, levels)
    torch.testing.assert_close(out, reference.hash_encode(points, table, levels))
    (grad,) = torch.autograd.grad(out.T[::2].sum(), table)
    (truth,) = torch.autograd.grad(reference.hash_encode(points, table, levels).T[::2].sum(), table)
    torch.testing.assert_close(grad, truth, atol=1e-5, rtol=1e-5)


def test_hash_encode_differentiates_points_where_they_ask():
    levels = reference.levels_of(2, 4, 8, 9)
    points = uniform(10, 3).requires_grad_()
    table = normal(levels[-1].offset + levels[-1].size, 2)
    (grad,) = torch.autograd.grad(native.hash_encode(points, table, levels).square().sum(), points)
    (truth,) = torch.autograd.grad(reference.hash_encode(points, table, levels).square().sum(), points)
    torch.testing.assert_close(grad, truth)
    assert grad.abs().max() > 0


def test_hash_encode_in_float64_is_the_reference():
    levels = reference.levels_of(2, 4, 8, 9)
    points, table = uniform(10, 3).double(), normal(levels[-1].offset + levels[-1].size, 2).double()
    assert torch.equal(native.hash_encode(points, table, levels), reference.hash_encode(points, table, levels))


@pytest.mark.parametrize("shape", [(0,), (7,), (33, 5), (70000,)])
def test_adam_equals_the_reference(isa, threads, shape):
    params = [normal(*shape), normal(*shape).double()]
    moments = [[torch.zeros_like(p), torch.zeros_like(p)] for p in params]
    for step in range(1, 11):
        # Magnitudes from 1e-9 to 1: Adam's step must not depend on them.
        grad = normal(*shape, seed=step) * 10 ** (-9 * uniform(*shape, seed=step))
        for backend, param, (m, v) in zip((native, reference), params, moments, strict=True):
            backend.adam_step(param, grad.to(param.dtype), m, v, step, 1e-2, 0.9, 0.99, 1e-15)
    torch.testing.assert_close(params[0], params[1].float(), atol=2e-6, rtol=0)
    torch.testing.assert_close(moments[0][1], moments[1][1].float(), rtol=1e-5, atol=0)


def test_adam_changes_a_view_in_place():
    param, m, v = normal(6, 4), torch.zeros(6, 4), torch.zeros(6, 4)
    truth = param.clone()
    native.adam_step(param[:, :2], torch.ones(6, 2), m[:, :2], v[:, :2], 1, 1e-2, 0.9, 0.99, 1e-15)
    torch.testing.assert_close(param[:, :2], truth[:, :2] - 1e-2)
    assert torch.equal(param[:, 2:], truth[:, 2:])
