import pytest
import torch

from inpaint3d.radiance import safe

MAGNITUDES = [0.0, *(s * 10.0**e for e in range(-38, 39, 4) for s in (1, -1))]


@pytest.mark.parametrize("magnitude", MAGNITUDES)
def test_exp_and_its_gradient_are_finite_and_equal(magnitude: float) -> None:
    x = torch.full((3,), magnitude, requires_grad=True)
    value = safe.exp(x)
    value.sum().backward()
    assert x.grad is not None
    assert torch.isfinite(value).all()
    torch.testing.assert_close(x.grad, value)


def test_exp_is_the_plain_one_below_its_ceiling_and_can_come_down_from_above() -> None:
    x = torch.linspace(-20, safe.EXP_CEILING, 50, dtype=torch.float64)
    torch.testing.assert_close(safe.exp(x), torch.exp(x))
    assert torch.autograd.gradcheck(safe.exp, (x[:-1].requires_grad_(),))
    high = torch.tensor([40.0], requires_grad=True)
    safe.exp(high).sum().backward()
    assert high.grad is not None
    assert high.grad > 0


@pytest.mark.parametrize("below", [0.0, 1e-38, 1e-20, 1.0, 1e38])
def test_divide_has_no_nan_in_value_or_gradient(below: float) -> None:
    a, b = torch.tensor([0.0, 1.0], requires_grad=True), torch.full((2,), below, requires_grad=True)
    value = safe.divide(a, b, otherwise=7.0, smallest=1e-3)
    value.sum().backward()
    for tensor in (value, a.grad, b.grad):
        assert tensor is not None
        assert torch.isfinite(tensor).all()
    if below <= 1e-3:
        assert (value == 7).all()
        assert a.grad is not None
        assert (a.grad == 0).all()


def test_the_plain_quotient_has_the_gradient_that_divide_avoids() -> None:
    b = torch.zeros(1, requires_grad=True)
    torch.where(b > 0, torch.ones(1) * 0 / b, 0.0).sum().backward()
    assert b.grad is not None
    assert b.grad.isnan().all()


@pytest.mark.parametrize("magnitude", [abs(m) for m in MAGNITUDES[1:]])
def test_length_of_any_magnitude(magnitude: float) -> None:
    direction = torch.tensor([0.48, -0.6, 0.64])
    x = (direction * min(magnitude, 3e38)).requires_grad_()
    value = safe.length(x)
    value.sum().backward()
    torch.testing.assert_close(value, torch.tensor([max(magnitude, 1.0)]), rtol=1e-6, atol=0)
    assert x.grad is not None
    expected = direction if magnitude > 1 else torch.zeros(3)
    torch.testing.assert_close(x.grad, expected)


def test_length_at_the_origin_has_a_gradient() -> None:
    x = torch.zeros(2, 3, requires_grad=True)
    safe.length(x).sum().backward()
    assert x.grad is not None
    assert (x.grad == 0).all()
