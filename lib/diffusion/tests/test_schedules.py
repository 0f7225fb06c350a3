import math

import pytest
import torch

from inpaint3d.diffusion.schedules import CLAMP, alpha, cosine_log_snr, sigma


@pytest.mark.parametrize("t", [0.0, 1e-12, 1e-6, 1e-4, 1 - 1e-4, 1 - 1e-6, 1.0])
def test_log_snr_is_clamped_and_its_gradient_finite_at_both_ends(t: float) -> None:
    time = torch.tensor(t, requires_grad=True)
    log_snr = cosine_log_snr(time)
    log_snr.backward()
    assert abs(log_snr.item()) <= CLAMP
    assert time.grad is not None
    assert torch.isfinite(time.grad)


def test_log_snr_reaches_the_clamp_at_the_ends_and_only_there() -> None:
    ends = cosine_log_snr(torch.tensor([0.0, 1.0], dtype=torch.float64))
    assert ends.tolist() == pytest.approx([20, -20], abs=1e-6)
    inside = cosine_log_snr(torch.tensor([1e-3, 0.999], dtype=torch.float64))
    assert inside.abs().max() < 14


def test_alpha_and_sigma_are_cosine_and_sine() -> None:
    t = torch.linspace(0.001, 0.999, 101, dtype=torch.float64)
    torch.testing.assert_close(alpha(t), torch.cos(t * math.pi / 2))
    torch.testing.assert_close(sigma(t), torch.sin(t * math.pi / 2))


def test_variance_is_preserved_everywhere() -> None:
    t = torch.cat([torch.tensor([0.0, 1.0]), torch.logspace(-8, -0.001, 50)])
    torch.testing.assert_close(alpha(t) ** 2 + sigma(t) ** 2, torch.ones_like(t))
    # What the clamp is for: both can be divided by.
    assert sigma(t).min() > 4e-5
    assert alpha(t).min() > 4e-5
