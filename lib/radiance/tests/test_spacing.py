import pytest
import torch

from inpaint3d.radiance.spacing import Spacing, below_limit, power_ladder


@pytest.mark.parametrize("spacing", [Spacing(0.05, 1000.0, True), Spacing(0.2, 6.0, False), Spacing(1e-3, 1e6, True)])
def test_there_and_back(spacing: Spacing) -> None:
    s = torch.linspace(0, 1, 101, dtype=torch.float64)
    t = spacing.metric_from_normalised(s)
    torch.testing.assert_close(spacing.normalised_from_metric(t), s)
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
def test_power_ladder_is_the_formula(p: float) -> None:
    x = torch.logspace(-6, 6, 40, dtype=torch.float64)
    formula = abs(p - 1) / p * ((3 * x / abs(p - 1) + 1) ** p - 1)  # Zip-NeRF, supplement
    torch.testing.assert_close(power_ladder(x, p, premult=3.0), formula)


def test_power_ladder_is_the_identity_near_zero_and_has_a_limit() -> None:
    tiny = torch.tensor([1e-7], dtype=torch.float64)
    torch.testing.assert_close(power_ladder(tiny, -1.0), tiny)
    torch.testing.assert_close(power_ladder(torch.tensor([1e30]), -1.0), torch.tensor([2.0]))


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


def test_a_ladder_without_a_limit_is_refused() -> None:
    with pytest.raises(ValueError, match="limit"):
        below_limit(torch.ones(1), 0.5)
