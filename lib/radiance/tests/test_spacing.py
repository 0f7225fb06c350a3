import pytest
import torch

from inpaint3d.radiance.spacing import Spacing, below_limit


def normalised_from_metric(spacing: Spacing, tdist: torch.Tensor) -> torch.Tensor:
    """The inverse, written down once more."""
    if not spacing.reciprocal:
        return (tdist - spacing.near) / (spacing.far - spacing.near)
    near, far = 1 / (1 + spacing.near), 1 / (1 + spacing.far)
    return (near - 1 / (1 + tdist)) / (near - far)


def power_ladder(x: torch.Tensor, p: float, premult: float) -> torch.Tensor:
    """Zip-NeRF, supplement."""
    return abs(p - 1) / p * ((premult * x / abs(p - 1) + 1) ** p - 1)


@pytest.mark.parametrize("spacing", [Spacing(0.05, 1000.0, True), Spacing(0.2, 6.0, False), Spacing(1e-3, 1e6, True)])
def test_there_and_back(spacing: Spacing) -> None:
    s = torch.linspace(0, 1, 101, dtype=torch.float64)
    t = spacing.metric_from_normalised(s)
    torch.testing.assert_close(normalised_from_metric(spacing, t), s)
    torch.testing.assert_close(t[[0, -1]], torch.tensor([spacing.near, spacing.far], dtype=torch.float64))
    assert (torch.diff(t) > 0).all()


def test_ends_are_exact_enough_in_single_precision() -> None:
    t = Spacing(0.05, 1000.0, True).metric_from_normalised(torch.tensor([0.0, 1.0]))
    # near: 1/(1 + t) rounds by 6e-8 of 1
    torch.testing.assert_close(t, torch.tensor([0.05, 1000.0]), rtol=3e-6, atol=0)


def test_reciprocal_spacing_is_even_nearby_and_in_disparity_far_away() -> None:
    t = Spacing(1e-3, 1e6, True).metric_from_normalised(torch.linspace(0, 1, 10_001, dtype=torch.float64))
    near, far = t[:500], t[-500:-1]
    steps = torch.diff(near)
    assert steps.max() / steps.min() < 1.15  # up to 5 % of a unit away
    disparity = torch.diff(1 / far)
    assert disparity.min() / disparity.max() < 1.15


@pytest.mark.parametrize("p", [-1.0, -0.25, -1.5])
def test_below_limit_is_what_the_ladder_lacks(p: float) -> None:
    x = torch.logspace(-6, 6, 40, dtype=torch.float64)
    torch.testing.assert_close((p - 1) / p - below_limit(x, p, premult=3.0), power_ladder(x, p, premult=3.0))


def test_below_limit_falls_from_the_limit_to_zero() -> None:
    tiny, huge = torch.tensor([1e-7, 1e30], dtype=torch.float64)
    torch.testing.assert_close(2 - below_limit(tiny, -1.0), tiny)
    assert below_limit(huge, -1.0) < 1e-29


def test_below_limit_keeps_what_the_ladder_forgets() -> None:
    t = torch.tensor([2000.0, 3000.0])
    assert torch.diff(power_ladder(t, -1.0, premult=20000.0)) == 0
    exact = torch.diff(power_ladder(t.double(), -1.0, premult=20000.0))
    torch.testing.assert_close(-torch.diff(below_limit(t, -1.0, premult=20000.0)).double(), exact, rtol=1e-6, atol=0)


@pytest.mark.parametrize("exponent", range(-38, 34, 4))
def test_any_distance_gives_finite_values_and_gradients(exponent: int) -> None:
    t = torch.full((3,), 10.0**exponent, requires_grad=True)
    value = below_limit(t, -1.0, premult=20000.0)
    value.sum().backward()
    assert t.grad is not None
    assert torch.isfinite(value).all()
    assert torch.isfinite(t.grad).all()


@pytest.mark.parametrize("p", [0.0, 0.5])
def test_a_ladder_without_a_limit_is_refused(p: float) -> None:
    with pytest.raises(ValueError, match="limit"):
        below_limit(torch.ones(1), p)
