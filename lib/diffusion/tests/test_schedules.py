import math

import pytest
import torch

from inpaint3d.diffusion.schedules import (
    CLAMP,
    alpha,
    cosine_log_snr,
    cosine_time,
    cosine_time_of,
    linear_log_snr,
    shifted_log_snr,
    sigma,
)


def shifted(t: torch.Tensor) -> torch.Tensor:
    return shifted_log_snr(t, size=256)


@pytest.mark.parametrize("schedule", [cosine_log_snr, linear_log_snr, shifted])
@pytest.mark.parametrize("t", [0.0, 1e-12, 1e-6, 1e-4, 1 - 1e-4, 1 - 1e-6, 1.0])
def test_log_snr_is_clamped_and_its_gradient_finite_at_both_ends(schedule, t: float) -> None:
    time = torch.tensor(t, requires_grad=True)
    log_snr = schedule(time)
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


def test_the_linear_schedule_is_that_of_a_thousand_linear_betas() -> None:
    """DDPM's own table, beta from 1e-4 to 0.02 in 1000 steps, of which the formula is the limit."""
    kept = torch.cumprod(1 - torch.linspace(1e-4, 0.02, 1000, dtype=torch.float64), 0)
    t = torch.arange(1, 1001, dtype=torch.float64) / 1000
    # A step of the table is a thousandth of the way: the two differ by that much where beta rises.
    torch.testing.assert_close(linear_log_snr(t)[20:], torch.log(kept / (1 - kept))[20:], rtol=0, atol=0.15)
    assert linear_log_snr(torch.zeros(1, dtype=torch.float64)).item() == pytest.approx(CLAMP, abs=1e-6)


def test_the_shifted_schedule_has_the_noise_of_block_means() -> None:
    t = torch.linspace(0.1, 0.9, 9, dtype=torch.float64)
    torch.testing.assert_close(shifted_log_snr(t, size=64), cosine_log_snr(t))
    # A mean over 4 x 4 pixels has a quarter of the noise's deviation: 16 times the signal-to-noise ratio.
    torch.testing.assert_close(shifted_log_snr(t, size=256) + math.log(16), cosine_log_snr(t))


def test_cosine_time_inverts_the_cosine_schedule() -> None:
    t = torch.linspace(1e-3, 1 - 1e-3, 101, dtype=torch.float64)
    torch.testing.assert_close(cosine_time(cosine_log_snr(t)), t)


@pytest.mark.parametrize(("schedule", "log_snr"), [("linear", linear_log_snr), ("shifted", shifted)])
def test_a_scheduled_time_is_as_noisy_as_its_schedule(schedule, log_snr) -> None:
    t = torch.linspace(0.01, 0.99, 50, dtype=torch.float64)
    torch.testing.assert_close(cosine_log_snr(cosine_time_of(t, schedule, 256)), log_snr(t))
    assert torch.equal(cosine_time_of(t, "cosine", 256), t)


@pytest.mark.parametrize("schedule", [cosine_log_snr, linear_log_snr])
def test_a_narrower_clamp_holds_at_both_ends(schedule) -> None:
    """The linear schedule ends at -10: clamping the time bounds it on one side alone."""
    ends = schedule(torch.tensor([0.0, 1.0], dtype=torch.float64), clamp=5.0)
    assert ends.tolist() == pytest.approx([5, -5], abs=1e-6)
