"""The native backend against the reference computed in float64, forward and backward."""

import copy
import importlib
import inspect
import itertools

import pytest
import torch
from torch.utils import _pytree as pytree

from inpaint3d.radiance import safe
from inpaint3d.radiance.architecture import levels_of
from inpaint3d.radiance.backends import reference, select
from inpaint3d.radiance.backends.reference import AdamStep

kernels = pytest.importorskip("inpaint3d.kernels", exc_type=ImportError)
native = importlib.import_module("inpaint3d.radiance.backends.native")


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


def test_the_native_backend_is_chosen_on_the_cpu_and_has_the_reference_signatures():
    assert select("cpu") is native
    for name in native.__all__:
        ours, theirs = (inspect.signature(getattr(module, name)).parameters for module in (native, reference))
        assert [(p.name, p.default) for p in ours.values()] == [(p.name, p.default) for p in theirs.values()]


# Below 2^7 every level hashes; at 2^15 all but the last are dense.
@pytest.mark.parametrize("log2_table", [3, 9, 15])
@pytest.mark.parametrize(("count", "channels"), [(1, 1), (333, 2), (65, 3), (200, 4), (64, 8)])
def test_hash_encode_equals_the_reference(isa, threads, log2_table, count, channels):
    levels = levels_of(5, 4, 61, log2_table)
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
    levels = levels_of(3, 4, 16, 9)
    table = normal(levels[-1].offset + levels[-1].size, 4).requires_grad_()
    out = native.hash_encode(torch.empty(0, 3), table, levels)
    assert out.shape == (0, 12)
    (grad,) = torch.autograd.grad(out.sum(), table)
    assert torch.equal(grad, torch.zeros_like(table))


def test_hash_encode_takes_views(isa):
    levels = levels_of(3, 4, 16, 9)
    entries = levels[-1].offset + levels[-1].size
    points, table = uniform(3, 40).T, normal(2, entries).T.requires_grad_()
    out = native.hash_encode(points, table, levels)
    torch.testing.assert_close(out, reference.hash_encode(points, table, levels))
    (grad,) = torch.autograd.grad(out.T[::2].sum(), table)
    (truth,) = torch.autograd.grad(reference.hash_encode(points, table, levels).T[::2].sum(), table)
    torch.testing.assert_close(grad, truth, atol=1e-5, rtol=1e-5)


def test_hash_encode_differentiates_points_where_they_ask():
    levels = levels_of(2, 4, 8, 9)
    points = uniform(10, 3).requires_grad_()
    table = normal(levels[-1].offset + levels[-1].size, 2)
    (grad,) = torch.autograd.grad(native.hash_encode(points, table, levels).square().sum(), points)
    (truth,) = torch.autograd.grad(reference.hash_encode(points, table, levels).square().sum(), points)
    torch.testing.assert_close(grad, truth)
    assert grad.abs().max() > 0


def network(*widths):
    return [normal(o, i, seed=o) / i**0.5 for i, o in itertools.pairwise(widths)]


def gradients(function, inputs, out_grads):
    """Outputs of function(*inputs), and the gradients of the inputs; all are computed in the inputs' dtype."""
    inputs = [tensor.detach().clone().requires_grad_() for tensor in inputs]
    outs = function(*inputs)
    outs = outs if isinstance(outs, tuple) else (outs,)
    return outs, torch.autograd.grad(outs, inputs, [grad.to(outs[0].dtype) for grad in out_grads])


@pytest.mark.parametrize(
    ("count", "widths", "run"),
    [
        (1, (3, 1), 0),
        (5, (1, 7, 2), 0),
        (6, (4, 1), 3),
        (193, (40, 64, 16), 0),
        (200, (15, 20, 3), 1),
        (400, (31, 64, 64, 3), 0),
        (576, (15, 64, 64, 3), 24),
        (97, (17, 33, 130, 49), 97),
        (386, (9, 16, 2), 193),
        (3100, (8, 5, 1), 0),
        (6400, (8, 5, 1), 50),
    ],
)
def test_mlp_equals_the_reference(isa, threads, count, widths, run):
    """run: rows that share a start; 0: there are none."""
    weights = network(*widths)
    starts = [normal(count // run, widths[1], seed=9)] if run else []
    depth = len(weights)
    x, out_grad = normal(count, widths[0], seed=7), normal(count, widths[-1], seed=8)
    with torch.no_grad():  # a unit within rounding of zero may open in one version alone: its rows teach nothing
        hidden, near_zero = x.double(), torch.zeros(count, dtype=torch.bool)
        for layer in range(depth - 1):
            hidden = hidden @ weights[layer].double().T
            if layer == 0 and run:
                hidden += starts[0].double().repeat_interleave(run, 0)
            near_zero |= (hidden.abs() < 1e-5).any(1)
            hidden = hidden.relu()
    assert near_zero.float().mean() < 0.1
    out_grad[near_zero] = 0

    def with_backend(backend):
        return lambda x, *p: backend.mlp(x, p[:depth], *p[depth:])

    inputs = [x, *weights, *starts]
    outs, grads = gradients(with_backend(native), inputs, [out_grad])
    truths, exact = gradients(with_backend(reference), [tensor.double() for tensor in inputs], [out_grad])
    torch.testing.assert_close(outs[0], truths[0].float(), atol=1e-5, rtol=1e-5)
    for grad, truth in zip(grads, exact, strict=True):  # sums over up to 3,100 rows
        scale = max(1.0, truth.abs().max().item())
        torch.testing.assert_close(grad, truth.float(), atol=1e-5 * scale, rtol=0)


def test_mlp_of_no_rows(isa):
    inputs = [torch.empty(0, 6), *network(6, 8, 2), torch.empty(0, 8)]
    outs, grads = gradients(lambda x, *p: native.mlp(x, p[:2], p[2]), inputs, [torch.empty(0, 2)])
    assert outs[0].shape == (0, 2)
    assert all(not grad.any() for grad in grads)


def test_mlp_bits_do_not_depend_on_threads():
    inputs = [normal(20000, 10), *network(10, 64, 4), normal(400, 64, seed=5)]
    results = []
    for count in (1, 2, 3):
        torch.set_num_threads(count)
        outs, grads = gradients(lambda x, *p: native.mlp(x, p[:2], p[2]), inputs, [normal(20000, 4)])
        results.append((*outs, *grads))
    torch.set_num_threads(1)
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_mlp_shows_nan(isa):
    x = normal(4, 3)
    x[1, 2] = torch.nan
    out = native.mlp(x, network(3, 8, 2), normal(2, 8))
    assert out[1].isnan().all()
    assert out[[0, 2, 3]].isfinite().all()


# From fog of 1e-8 to walls of 1e4 per interval.
@pytest.mark.parametrize("decades", [(-8, -6), (-3, 1), (0, 4)])
@pytest.mark.parametrize(("rays", "samples"), [(0, 8), (1, 1), (3, 63), (300, 32), (5, 130)])
def test_composite_equals_the_reference(isa, threads, rays, samples, decades):
    low, high = decades
    density = 10 ** (low + (high - low) * uniform(rays, samples))
    rgb, tdist = uniform(rays, samples, 3, seed=1), normal(rays, samples + 1, seed=2).abs().cumsum(1)
    out_grads = [normal(rays, samples), normal(rays, 3), normal(rays), normal(rays)]

    def run(backend):
        return lambda density, rgb: backend.composite(density, rgb, tdist.to(rgb.dtype))

    outs, grads = gradients(run(native), [density, rgb], out_grads)
    truths, exact = gradients(run(reference), [density.double(), rgb.double()], out_grads)
    for out, truth in zip(outs, truths, strict=True):
        torch.testing.assert_close(out, truth.float(), atol=1e-6, rtol=2e-5)  # distances reach 100
    # The density's gradient is a difference of sums of up to 130 terms times distances of up to 100.
    scale = max(1.0, exact[0].abs().max().item() if rays else 0.0)
    torch.testing.assert_close(grads[0], exact[0].float(), atol=2e-5 * scale, rtol=1e-4)
    torch.testing.assert_close(grads[1], exact[1].float(), atol=1e-6, rtol=2e-5)


def test_composite_keeps_thin_fog_and_infinite_walls(isa):
    density = torch.tensor([[1e-8, torch.inf, 1.0]])
    weights, _, opacity, _ = native.composite(density, torch.ones(1, 3, 3), torch.tensor([[0.0, 1, 2, 3]]))
    torch.testing.assert_close(weights, torch.tensor([[1e-8, 1.0, 0.0]]), rtol=1e-6, atol=0)
    torch.testing.assert_close(opacity, torch.ones(1))


def test_composite_differentiates_distances_where_they_ask():
    tdist = torch.linspace(0, 2, 5)[None].requires_grad_()
    outs = native.composite(torch.ones(1, 4), torch.ones(1, 4, 3), tdist)
    (grad,) = torch.autograd.grad(outs[3].sum(), tdist)
    assert grad.abs().max() > 0


@pytest.mark.parametrize("jittered", [False, True])
@pytest.mark.parametrize(("rays", "n", "count"), [(0, 4, 4), (1, 1, 2), (300, 64, 32), (7, 33, 64)])
def test_resample_equals_the_reference(isa, threads, rays, n, count, jittered):
    steps = uniform(rays, n) + 0.1
    sdist = torch.nn.functional.pad(steps.cumsum(1) / steps.sum(1, keepdim=True), (1, 0))
    weights = uniform(rays, n, seed=1) ** 4
    weights[: rays // 10] = 0  # empty rays
    jitter = uniform(rays, count, seed=2) if jittered else None
    out = native.resample(sdist, weights, count, jitter)
    # In float32, since the reference's eps depends on the dtype. Where a histogram is nearly empty, a rounding of its
    # distribution function (1e-7) moves a draw by that over the density there.
    truth = reference.resample(sdist, weights, count, jitter)
    torch.testing.assert_close(out, truth, atol=2e-4, rtol=0)
    assert (out - truth).abs().median() < 1e-6 if rays else True
    assert (torch.diff(out) >= 0).all()
    assert (out[:, 0] >= sdist[:, 0]).all()
    assert (out[:, -1] <= sdist[:, -1]).all()


def test_resample_takes_a_jitter_of_any_size(isa):
    sdist, weights = torch.linspace(0, 1, 5).expand(2, 5), torch.ones(2, 4)
    jitter = torch.tensor([[-5.0, 9.0, 0.0], [2.0, 1.0, -1.0]])
    out = native.resample(sdist, weights, 3, jitter)
    torch.testing.assert_close(out, reference.resample(sdist, weights, 3, jitter))


@pytest.mark.parametrize("specular", [True, False])
@pytest.mark.parametrize(
    ("count", "exposures"), [(0, None), (1, None), (5000, None), (0, 3), (5000, 1), (48, 3), (1750, 70)]
)
def test_colours_equal_the_reference(isa, threads, count, exposures, specular):
    given = [5 * normal(count, 3)]
    given.append(5 * normal(3, count, seed=1).T if specular else None)  # not contiguous
    given.append(None if exposures is None else normal(exposures, 6, seed=2))
    out_grads = [normal(count, 3, seed=3), normal(count, 3, seed=4)]

    def run(colours, dtype):
        inputs = [None if tensor is None else tensor.to(dtype).detach().requires_grad_() for tensor in given]
        outs = colours(*inputs, 0.7)
        torch.autograd.backward(outs, [grad.to(dtype) for grad in out_grads])
        return outs, [tensor.grad for tensor in inputs if tensor is not None]

    (outs, grads), (truth, exact) = run(native.colours, torch.float32), run(reference.colours, torch.float64)
    for ours, theirs in zip(outs, truth, strict=True):
        torch.testing.assert_close(ours.double(), theirs, atol=1e-6, rtol=0)
    for ours, theirs in zip(grads, exact, strict=True):
        largest = theirs.abs().max().item() if theirs.numel() else 0.0
        torch.testing.assert_close(ours.double(), theirs, atol=1e-5 * max(1.0, largest), rtol=0)


@pytest.mark.parametrize("used", [0, 1])
def test_a_colour_that_nothing_follows_from_has_no_part_in_the_gradient(isa, used):
    given = [normal(20, 3, seed=seed).requires_grad_() for seed in (0, 1)]
    ours, theirs = (
        torch.autograd.grad(colours(*given, None)[used].sum(), given, allow_unused=True, materialize_grads=True)
        for colours in (native.colours, reference.colours)
    )
    for mine, truth in zip(ours, theirs, strict=True):
        torch.testing.assert_close(mine, truth, atol=1e-6, rtol=1e-5)


def test_nan_logits_show_and_extreme_ones_stay_finite(isa):
    logits = torch.tensor([[float("nan"), -1e30, 1e30]]).requires_grad_()
    shown, _ = native.colours(logits, None, None)
    shown.sum().backward()
    assert shown[0].isnan().tolist() == [True, False, False]
    assert shown[0, 1:].tolist() == pytest.approx([-reference.COLOUR_PADDING, 1 + reference.COLOUR_PADDING])
    # What is all black or all white can become grey again.
    slope = safe.LEAST_SLOPE * (1 + 2 * reference.COLOUR_PADDING)
    assert logits.grad[0, 1:].tolist() == pytest.approx([slope, slope])


def clear_of_cell_borders(origins, directions, tdist, side, contraction, bound):
    """Rays none of whose middles lies so close to a cell's border that rounding decides which it is in."""
    middle = (tdist[1:] + tdist[:-1]).double() / 2
    points = origins.double()[:, None] + directions.double()[:, None] * middle[:, None]
    place = reference.unit_cube(points.reshape(-1, 3), contraction, bound) * side
    return ((place - place.round()).abs() > 1e-4).reshape(len(origins), 3 * len(middle)).all(1)


@pytest.mark.parametrize("contraction", [True, False])
@pytest.mark.parametrize(("rays", "bins", "side"), [(0, 5, 4), (1, 1, 1), (700, 64, 9), (200, 33, 96)])
def test_grid_histogram_equals_the_reference(isa, threads, rays, bins, side, contraction):
    bound = 2.3  # of a capture: no number that float32 holds exactly
    tdist = torch.linspace(0.01, 6.0, bins + 1) ** 2
    density = uniform(side**3) * 0.2
    density[::7] = 50.0
    origins, directions = 0.5 * normal(rays, 3), torch.nn.functional.normalize(normal(rays, 3, seed=1), dim=-1)
    sure = clear_of_cell_borders(origins, directions, tdist, side, contraction, bound)
    assert rays == 0 or sure.sum() > 0.4 * rays
    cells = reference.Cells(density, side, contraction, bound)
    out = native.grid_histogram(cells, origins, directions, tdist, 0.01)
    exact = cells._replace(density=density.double())
    truth = reference.grid_histogram(exact, origins.double(), directions.double(), tdist.double(), 0.01)
    assert out.shape == (rays, bins)
    torch.testing.assert_close(out[sure].double(), truth[sure], atol=3e-6, rtol=0)


def test_a_cube_may_have_any_bound():
    # 2.3 is no float32: a kernel that takes nothing else would refuse it.
    tdist, density = torch.linspace(0.01, 4.0, 9), uniform(4**3)
    origins, directions = 0.5 * normal(5, 3), torch.nn.functional.normalize(normal(5, 3, seed=1), dim=-1)
    cells = reference.Cells(density, 4, contraction=False, bound=2.3)
    found, truth = (b.grid_histogram(cells, origins, directions, tdist, 0.01) for b in (native, reference))
    torch.testing.assert_close(found, truth)


@pytest.mark.parametrize("count", [0, 1, 3000])
def test_grid_learn_equals_the_reference(isa, count):
    side = 6
    density = uniform(side**3)
    density[:20] = 0.0
    cube, seen = uniform(count, 3, seed=1) * 1.4 - 0.2, uniform(count, seed=2)  # some outside: the border learns
    truth = density.clone()
    native.grid_learn(density, side, cube, seen, 0.5)
    reference.grid_learn(truth, side, cube, seen, 0.5)
    assert torch.equal(density, truth)
    assert not torch.signbit(density).any()


@pytest.mark.parametrize("count", [0, 1, 33, 5000])
def test_unit_cube_equals_the_reference(isa, threads, count):
    points = normal(3, count).T * 10 ** (6 * uniform(count, 1) - 2)
    truth = reference.unit_cube(points.double(), True, 1.0)
    torch.testing.assert_close(native.unit_cube(points, True, 1.0), truth.float(), atol=2e-7, rtol=0)
    assert torch.equal(native.unit_cube(points, False, 3.0), reference.unit_cube(points, False, 3.0))


def test_unit_cube_differentiates_points_where_they_ask():
    points = normal(9, 3).requires_grad_()
    (grad,) = torch.autograd.grad(native.unit_cube(points, True, 1.0).square().sum(), points)
    assert grad.abs().max() > 0


def histogram(rays, n, seed):
    steps = uniform(rays, n, seed=seed) + 0.05
    ends = torch.nn.functional.pad(steps.cumsum(1) / steps.sum(1, keepdim=True), (1, 0))
    return ends, uniform(rays, n, seed=seed + 1) / n


@pytest.mark.parametrize(("rays", "n", "m"), [(0, 4, 4), (1, 1, 1), (300, 24, 48), (7, 33, 64)])
def test_interlevel_equals_the_reference(isa, threads, rays, n, m):
    (ends, weights), (other_ends, other_weights) = histogram(rays, n, seed=0), histogram(rays, m, seed=5)
    # Not contiguous, and too small to bound the first.
    other_weights = (0.5 * other_weights).T.contiguous().T
    exact = [tensor.double() for tensor in (ends, weights, other_ends)]
    out_grad = normal(rays)
    outs, grads = gradients(lambda w: native.interlevel(ends, weights, other_ends, w), [other_weights], [out_grad])
    truths, slopes = gradients(lambda w: reference.interlevel(*exact, w), [other_weights.double()], [out_grad])
    torch.testing.assert_close(outs[0], truths[0].float(), atol=1e-6, rtol=1e-4)
    torch.testing.assert_close(grads[0], slopes[0].float(), atol=1e-4, rtol=1e-4)


def test_cube_and_interlevel_bits_do_not_depend_on_threads():
    points, histograms = normal(20000, 3), (*histogram(700, 24, 0), *histogram(700, 48, 5))
    results = []
    for count in (1, 2):
        torch.set_num_threads(count)
        outs, grads = gradients(lambda w: native.interlevel(*histograms[:3], w), [histograms[3]], [normal(700)])
        results.append((native.unit_cube(points, True, 1.0), *outs, *grads))
    torch.set_num_threads(1)
    assert all(torch.equal(a, b) for a, b in zip(*results, strict=True))


@pytest.mark.parametrize("shape", [(0,), (7,), (33, 5), (70000,)])
@pytest.mark.parametrize("decay", [0.0, 1e-3])
@pytest.mark.parametrize("sparse", [False, True])
def test_adam_equals_the_reference(isa, threads, shape, decay, sparse):
    params = [normal(*shape), normal(*shape).double()]
    moments = [[torch.zeros_like(p), torch.zeros_like(p)] for p in params]
    for step in range(1, 11):
        # Magnitudes from 1e-9 to 1: Adam's step must not depend on them.
        grad = normal(*shape, seed=step) * 10 ** (-9 * uniform(*shape, seed=step))
        grad[uniform(*shape, seed=step + 100) < 0.4] = 0
        if grad.numel():
            grad.view(-1)[-1] = torch.nan
        for backend, param, (m, v) in zip((native, reference), params, moments, strict=True):
            how = AdamStep(step, 1e-2, 0.9, 0.99, 1e-15, decay, sparse)
            assert backend.adam_step(param, grad.to(param.dtype), m, v, how) == min(1, grad.numel())
    torch.testing.assert_close(params[0], params[1].float(), atol=2e-6, rtol=0)
    torch.testing.assert_close(moments[0][1], moments[1][1].float(), rtol=1e-5, atol=0)


def test_adam_changes_a_view_in_place():
    param, m, v = normal(6, 4), torch.zeros(6, 4), torch.zeros(6, 4)
    truth = param.clone()
    native.adam_step(param[:, :2], torch.ones(6, 2), m[:, :2], v[:, :2], AdamStep(1, 1e-2, 0.9, 0.99, 1e-15))
    torch.testing.assert_close(param[:, :2], truth[:, :2] - 1e-2)
    assert torch.equal(param[:, 2:], truth[:, 2:])


LEVELS = levels_of(2, 4, 8, 9)
ENDS = torch.linspace(0, 1, 7).expand(4, -1).double()
PARTS = uniform(4, 6).double()
IN_FLOAT64 = {
    "hash_encode": (uniform(9, 3).double(), normal(LEVELS[-1].offset + LEVELS[-1].size, 2).double(), LEVELS),
    "mlp": (normal(6, 5).double(), [weight.double() for weight in network(5, 4, 3)], normal(2, 4).double()),
    "colours": (normal(6, 3).double(), normal(6, 3, seed=1).double(), normal(2, 6).double()),
    "composite": (PARTS, uniform(4, 6, 3).double(), ENDS),
    "resample": (ENDS, PARTS, 5, uniform(4, 5).double()),
    "interlevel": (ENDS, PARTS, ENDS, PARTS.flip(1)),
    "unit_cube": (3 * normal(9, 3).double(), True, 1.0),
    "grid_histogram": (
        reference.Cells(uniform(8).double(), 2, True, 1.0), normal(4, 3).double(), normal(4, 3, seed=1).double(),
        ENDS[0], 0.01,
    ),
    "grid_learn": (uniform(8).double(), 2, uniform(5, 3).double(), uniform(5).double(), 0.5),
    "adam_step": (*(uniform(7, seed=k).double() for k in range(4)), AdamStep(2, 0.1, 0.9, 0.99, 1e-8)),
}  # fmt: skip
"""What the kernels do not take goes to the reference."""


@pytest.mark.parametrize("name", IN_FLOAT64)
def test_operations_in_float64_are_the_reference(name):
    assert set(IN_FLOAT64) == set(native.__all__)
    given, truth = copy.deepcopy((IN_FLOAT64[name], IN_FLOAT64[name]))
    ours, theirs = getattr(native, name)(*given), getattr(reference, name)(*truth)
    for a, b in zip(*(pytree.tree_leaves(x) for x in ((ours, given), (theirs, truth))), strict=True):
        assert torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b
