"""An untrained `residual` prior outputs 0: the exact denoiser of N(fill, d^2), so that all here has closed forms."""

import pytest
import torch

from inpaint3d.diffusion.distillation import denoised_target_gradient, sample_t, sds_gradient, t_range
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

T = torch.tensor([0.35, 0.8])


@pytest.fixture
def prior(shipped_like) -> InpaintingPrior:
    return InpaintingPrior(shipped_like)


def _eps(seed: int = 0) -> torch.Tensor:
    return torch.randn(2, 3, 16, 16, generator=torch.Generator().manual_seed(seed))


def test_sds_is_the_closed_form_of_a_gaussian(prior, picture, hole) -> None:
    eps, d = _eps(), prior.spec.residual_bands[0]
    a, s = per_image(alpha(T)), per_image(sigma(T))
    offset = picture - prior.filled(picture, hole)
    # eps_hat = s (a (x - fill) + s eps) / (a^2 d^2 + s^2), and w = s^2.
    expected = s**2 * (s * a * offset - a**2 * d**2 * eps) / (a**2 * d**2 + s**2) * hole
    torch.testing.assert_close(sds_gradient(prior, picture, hole, T, eps), expected, rtol=1e-4, atol=1e-6)


def test_descending_sds_moves_the_hole_towards_what_the_prior_believes(prior, picture, hole) -> None:
    belief = prior.filled(picture, hole)
    x = belief + 0.8 * hole
    for i in range(200):
        x = x - 0.5 * sds_gradient(prior, x, hole, T, _eps(i))
    assert ((x - belief) * hole).mean().abs() < 0.05 * hole.mean()
    assert torch.equal(x * (1 - hole), belief * (1 - hole))


def test_the_denoised_target_is_the_gaussians_quantile(prior, picture, hole) -> None:
    eps, d = _eps(), prior.spec.residual_bands[0]
    a, s = per_image(alpha(T)), per_image(sigma(T))
    fill = prior.filled(picture, hole)
    z = a * picture + s * eps
    target = fill + d * (z - a * fill) / (a**2 * d**2 + s**2).sqrt()
    gradient = denoised_target_gradient(prior, picture, hole, T, eps, steps=200)
    inside = (hole.expand_as(target) > 0) & (target.abs() < 0.9)
    # DDIM is first order in the number of steps.
    torch.testing.assert_close(gradient[inside], (picture - target)[inside], rtol=0, atol=0.01)


def test_one_step_of_the_denoised_target_is_sds_up_to_its_weight(prior, picture, hole) -> None:
    eps = _eps()
    a, s = per_image(alpha(T)), per_image(sigma(T))
    sds = sds_gradient(prior, 0.2 * picture, hole, T, 0.1 * eps)
    target = denoised_target_gradient(prior, 0.2 * picture, hole, T, 0.1 * eps, steps=1)
    # The target stops at t = 0, where the clamp leaves sigma = 4.5e-5 of noise.
    torch.testing.assert_close(sds, a * s * target, rtol=0, atol=2e-4)


@pytest.mark.parametrize("gradient_of", [sds_gradient, denoised_target_gradient])
@pytest.mark.parametrize("guidance", [1.0, 4.0])
def test_no_gradient_flows_through_prior_or_condition(gradient_of, guidance, prior, picture, hole) -> None:
    theta = picture.clone().requires_grad_()
    x = torch.tanh(theta)
    gradient = gradient_of(prior, x, hole, T, _eps(), guidance=guidance)
    assert not gradient.requires_grad
    x.backward(gradient)
    assert theta.grad is not None
    # dx/dtheta alone: were y = (1 - M) x or z_t differentiated, known pixels would move too.
    torch.testing.assert_close(theta.grad, gradient * (1 - x.detach() ** 2))
    assert torch.equal(theta.grad * (1 - hole), torch.zeros_like(theta))
    assert all(parameter.grad is None for parameter in prior.parameters())


def test_the_condition_is_the_rendered_patch_outside_the_hole(prior, picture, hole) -> None:
    known_changed = torch.where(hole > 0, picture, -picture)
    one, two = (sds_gradient(prior, x, hole, T, _eps()) for x in (picture, known_changed))
    assert (one - two).abs().max() > 1e-3


def test_a_noise_fill_prior_is_shown_its_noise(paper_like, picture, hole) -> None:
    prior = InpaintingPrior(paper_like)
    gradient = sds_gradient(prior, picture, hole, T, _eps(), noise_fill=_eps(1))
    # Untrained, eps_hat is 0: the gradient is -w eps M.
    torch.testing.assert_close(gradient, -(per_image(sigma(T)) ** 2) * _eps() * hole)


def test_t_falls_as_in_the_paper_and_stops_at_the_floor() -> None:
    assert t_range(0, 2200) == pytest.approx((0.75, 0.95))
    assert t_range(1100, 2200) == pytest.approx((0.275, 0.475))
    # eta - 0.2 would be 0 there: the floor holds.
    assert t_range(2200, 2200) == pytest.approx((0.02, 0.2))
    drawn = sample_t(1100, 2200, 4096, torch.Generator().manual_seed(0))
    assert drawn.min() >= 0.275
    assert drawn.max() <= 0.475
    assert drawn.mean().item() == pytest.approx(0.375, abs=0.005)
