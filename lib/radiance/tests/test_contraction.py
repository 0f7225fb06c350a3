import pytest
import torch

from inpaint3d.radiance.contraction import contract, unit_cube


def on_sphere(count: int, radius: float, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    points = torch.randn(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return (points / torch.linalg.vector_norm(points, dim=-1, keepdim=True) * radius).to(dtype)


@pytest.mark.parametrize("radius", [0.0, 1e-38, 1e-20, 1e-3, 0.5, 0.999])
def test_exact_identity_inside_the_unit_ball(radius: float) -> None:
    points = on_sphere(500, radius).requires_grad_()
    contracted = contract(points)
    assert torch.equal(contracted, points)
    contracted.sum().backward()
    assert points.grad is not None
    assert torch.equal(points.grad, torch.ones_like(points))


@pytest.mark.parametrize("radius", [1.001, 2.0, 10.0, 1e4, 1e10, 1e19, 1e30, 1e38])
def test_outside_the_radius_is_two_minus_its_inverse(radius: float) -> None:
    points = on_sphere(500, radius).requires_grad_()
    contracted = contract(points)
    found = torch.linalg.vector_norm(contracted, dim=-1)
    torch.testing.assert_close(found, torch.full_like(found, 2 - 1 / radius))
    # the direction is kept
    torch.testing.assert_close(contracted / found[:, None], points / radius)
    contracted.sum().backward()
    assert points.grad is not None
    assert torch.isfinite(points.grad).all()


def test_continuous_across_the_unit_sphere() -> None:
    step = 1e-6
    gap = contract(on_sphere(100, 1 + step, torch.float64)) - contract(on_sphere(100, 1 - step, torch.float64))
    assert torch.linalg.vector_norm(gap, dim=-1).max() < 3 * step


def test_gradient() -> None:
    points = torch.cat([on_sphere(5, r, torch.float64) for r in (0.3, 0.9, 1.5, 40.0)]).requires_grad_()
    assert torch.autograd.gradcheck(contract, (points,))


def test_the_cube_holds_all_of_space_or_the_bound() -> None:
    everything = unit_cube(on_sphere(500, 1e30), contraction=True, bound=1.0)
    assert everything.min() >= 0
    assert everything.max() <= 1
    corners = torch.tensor([[-3.0, 3.0, 0.0]])
    torch.testing.assert_close(unit_cube(corners, contraction=False, bound=3.0), torch.tensor([[0.0, 1.0, 0.5]]))
