"""Pictures of splats: the reference against closed forms, the kernels against the reference in float64."""

import importlib
import math

import pytest
import torch

from inpaint3d.radiance.splats import NEAR, Splats, View, reference

kernels = pytest.importorskip("inpaint3d.kernels", exc_type=ImportError)
native = importlib.import_module("inpaint3d.radiance.splats.native")


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


def front(width=37, height=29, focal=40.0):
    """A camera at the origin that looks along z, its centre off the picture's middle."""
    return View((focal, 1.1 * focal, width / 2 + 2, height / 2 - 1), width, height, torch.eye(4)[:3].contiguous())


def turned():
    angle = torch.tensor(0.3)
    pose = torch.eye(4)[:3].clone()
    pose[0, 0] = pose[2, 2] = angle.cos()
    pose[0, 2], pose[2, 0] = angle.sin(), -angle.sin()
    pose[:, 3] = torch.tensor([0.1, -0.2, 0.3])
    return View((40.0, 44.0, 20.0, 13.0), 37, 29, pose)


def scatter(count, seed=0, size=0.1):
    """Splats before `front`, some of them behind it, beside it, and close."""
    g = torch.Generator().manual_seed(seed)
    mean = torch.randn(count, 3, generator=g) * torch.tensor([0.8, 0.7, 1.0]) + torch.tensor([0, 0, 2.0])
    return Splats(
        mean,
        math.log(size) + 0.7 * torch.randn(count, 3, generator=g),
        torch.randn(count, 4, generator=g) * 3,
        2 * torch.randn(count, generator=g),
        torch.rand(count, 3, generator=g),
    )


def one(z=2.0, scale=0.2, opacity=0.0):
    return Splats(
        torch.tensor([[0.0, 0.0, z]]),
        torch.full((1, 3), math.log(scale)),
        torch.tensor([[1.0, 0, 0, 0]]),
        torch.tensor([opacity]),
        torch.tensor([[0.2, 0.6, 1.0]]),
    )


def test_a_round_splat_on_the_axis_is_a_gaussian_of_its_projected_size():
    view = front()
    fx, fy, cx, cy = view.intrinsics
    rgb = reference.render_splats(one().map(torch.Tensor.double), view)
    x, y = torch.arange(37, dtype=torch.float64) + 0.5 - cx, torch.arange(29, dtype=torch.float64) + 0.5 - cy
    spread_x, spread_y = (0.2 * fx / 2) ** 2 + 0.3, (0.2 * fy / 2) ** 2 + 0.3
    alpha = 0.5 * torch.exp(-(x**2) / (2 * spread_x) - (y**2)[:, None] / (2 * spread_y))
    alpha = alpha * (alpha >= 1 / 255)
    torch.testing.assert_close(
        rgb, alpha[..., None] * torch.tensor([0.2, 0.6, 1.0], dtype=torch.float64), rtol=1e-6, atol=1e-7
    )


def test_the_nearer_splat_hides_the_farther_one():
    far, near = one(3.0, 1.0, 20.0), one(2.0, 1.0, 20.0)
    both = Splats(*(torch.cat(pair) for pair in zip(far.tensors, near.tensors, strict=True)))
    both.rgb[1] = 0.5
    rgb = reference.render_splats(both, front())
    centre = rgb[14, 20]
    torch.testing.assert_close(centre, 0.99 * torch.full((3,), 0.5) + 0.01 * 0.99 * far.rgb[0], atol=0.005, rtol=0)


def test_what_is_behind_the_camera_or_close_to_it_is_not_seen():
    view = front()
    for z in (-2.0, 0.0, 0.9 * NEAR):
        assert reference.render_splats(one(z), view).abs().max() == 0
    assert reference.render_splats(one(1.1 * NEAR), view).max() > 0


@pytest.mark.parametrize(
    "view", [front(), front(16, 16), front(3, 2), turned()], ids=["odd", "a tile", "tiny", "turned"]
)
@pytest.mark.parametrize(("count", "size"), [(0, 1), (1, 0.1), (70, 0.003), (70, 0.1), (300, 0.6)])
def test_the_kernels_equal_the_reference(isa, threads, view, count, size):
    splats = scatter(count, size=size).map(torch.Tensor.requires_grad_)
    exact = splats.map(lambda t: t.detach().double().requires_grad_())
    out_grad = torch.randn(view.height, view.width, 3, generator=torch.Generator().manual_seed(1))
    rgb, truth = native.render_splats(splats, view), reference.render_splats(exact, view)
    # A pixel where a splat's opacity is 1/255 but for rounding is in one of the two alone.
    assert ((rgb - truth).abs().amax(-1) > 2e-5).float().mean() <= 0.01
    torch.testing.assert_close(rgb, truth.float(), atol=1.01 / 255, rtol=0)
    rgb.backward(out_grad)
    truth.backward(out_grad.double())
    for ours, theirs in zip(splats.tensors, exact.tensors, strict=True):
        scale = theirs.grad.abs().amax().clamp(min=1e-3) if count else 1.0
        torch.testing.assert_close(ours.grad / scale, (theirs.grad / scale).float(), atol=3e-3, rtol=0)


def test_results_do_not_depend_on_threads(isa):
    view, found, before = front(), [], torch.get_num_threads()
    for count in (1, 2, 3):
        torch.set_num_threads(count)
        splats = scatter(200).map(torch.Tensor.requires_grad_)
        rgb = native.render_splats(splats, view)
        rgb.square().sum().backward()
        found.append((rgb.detach(), *(t.grad for t in splats.tensors)))
    torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(a, b) for a, b in zip(found[0], other, strict=True))
