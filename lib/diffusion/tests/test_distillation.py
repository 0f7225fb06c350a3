"""An untrained `residual` prior outputs 0: the exact denoiser of N(fill, d^2), so that all here has closed forms."""

import pytest
import torch

from inpaint3d.diffusion.distillation import (
    T_FLOOR,
    PriorQuery,
    dataset_gradient,
    denoised_target,
    denoised_target_gradient,
    ism_gradient,
    nfsd_gradient,
    sdi_gradient,
    sds_gradient,
    vsd_gradient,
)
from inpaint3d.diffusion.low_rank import LowRankCopy
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
    offset = picture - prior.fill_hole(picture, hole)
    # eps_hat = s (a (x - fill) + s eps) / (a^2 d^2 + s^2), and w = s^2.
    expected = s**2 * (s * a * offset - a**2 * d**2 * eps) / (a**2 * d**2 + s**2) * hole
    torch.testing.assert_close(sds_gradient(prior, PriorQuery(picture, hole, T, eps)), expected, rtol=1e-4, atol=1e-6)


def test_descending_sds_moves_the_hole_towards_what_the_prior_believes(prior, picture, hole) -> None:
    belief = prior.fill_hole(picture, hole)
    x = belief + 0.8 * hole
    for i in range(200):
        x = x - 0.5 * sds_gradient(prior, PriorQuery(x, hole, T, _eps(i)))
    assert ((x - belief) * hole).mean().abs() < 0.05 * hole.mean()
    assert torch.equal(x * (1 - hole), belief * (1 - hole))


def test_the_denoised_target_is_the_gaussians_quantile(prior, picture, hole) -> None:
    eps, d = _eps(), prior.spec.residual_bands[0]
    a, s = per_image(alpha(T)), per_image(sigma(T))
    fill = prior.fill_hole(picture, hole)
    z = a * picture + s * eps
    target = fill + d * (z - a * fill) / (a**2 * d**2 + s**2).sqrt()
    gradient = denoised_target_gradient(prior, PriorQuery(picture, hole, T, eps), steps=200)
    inside = (hole.expand_as(target) > 0) & (target.abs() < 0.9)
    # DDIM is first order in the number of steps.
    torch.testing.assert_close(gradient[inside], (picture - target)[inside], rtol=0, atol=0.01)


def test_one_step_of_the_denoised_target_is_sds_up_to_its_weight(prior, picture, hole) -> None:
    eps = _eps()
    a, s = per_image(alpha(T)), per_image(sigma(T))
    sds = sds_gradient(prior, PriorQuery(0.2 * picture, hole, T, 0.1 * eps))
    target = denoised_target_gradient(prior, PriorQuery(0.2 * picture, hole, T, 0.1 * eps), steps=1)
    # The target stops at t = 0, where the clamp leaves sigma = 4.5e-5 of noise.
    torch.testing.assert_close(sds, a * s * target, rtol=0, atol=2e-4)


def _levels(t: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    return per_image(alpha(t)), per_image(sigma(t))


def _noise_of(z: torch.Tensor, t: torch.Tensor, mean: torch.Tensor, d: float) -> torch.Tensor:
    """The exact eps_hat of N(mean, d^2)."""
    a, s = _levels(t)
    return s * (z - a * mean) / (a**2 * d**2 + s**2)


def test_noise_free_distillation_is_the_closed_form_of_gaussians(prior, picture, hole) -> None:
    """Under t = 0.2 eps_null + g (eps_cond - eps_null); above it less the noise under the smoothed condition."""
    eps, d, t = _eps(), prior.spec.residual_bands[0], torch.tensor([0.1, 0.6])
    a, s = _levels(t)
    z = a * picture + s * eps
    fill, known = prior.fill_hole(picture, hole), 1 - hole
    null, cond = _noise_of(z, t, torch.zeros_like(z), d), _noise_of(z, t, fill, d)
    smooth = torch.nn.functional.avg_pool2d(picture * known, 5, 1, 2)
    smooth = smooth / torch.nn.functional.avg_pool2d(known, 5, 1, 2).clamp(min=1e-7)
    negative = _noise_of(z, t, prior.fill_hole(smooth, hole), d)
    delta = null + 3.0 * (cond - null)
    expected = s**2 * torch.stack([delta[0], (delta - negative)[1]]) * hole
    torch.testing.assert_close(
        nfsd_gradient(prior, PriorQuery(picture, hole, t, eps), guidance=3.0), expected, rtol=1e-3, atol=1e-5
    )


def test_above_its_split_noise_free_distillation_does_not_feel_the_noise(prior, picture, hole) -> None:
    """Of a Gaussian both estimates hold the same share of eps, so that the difference is free of it; SDS is not."""
    one, two = (nfsd_gradient(prior, PriorQuery(picture, hole, T, _eps(seed))) for seed in (0, 1))
    torch.testing.assert_close(one, two, rtol=1e-3, atol=1e-5)
    one, two = (sds_gradient(prior, PriorQuery(picture, hole, T, _eps(seed))) for seed in (0, 1))
    assert (one - two).abs().max() > 0.1


def test_inverted_noise_points_straight_to_what_the_prior_believes(prior, picture, hole) -> None:
    """SDI: z_t on the flow of a Gaussian is linear in x, so that the gradient is a multiple of x - fill, no noise."""
    d = prior.spec.residual_bands[0]
    a, s = _levels(T)
    a0, s0 = _levels(torch.full_like(T, T_FLOOR))
    fill = prior.fill_hole(picture, hole)
    spread, spread0 = (a**2 * d**2 + s**2).sqrt(), (a0**2 * d**2 + s0**2).sqrt()
    z = a * fill + spread / spread0 * (picture - a0 * fill)
    expected = s**2 * (s * (z - a * fill) / spread**2 - (z - a * picture) / s) * hole
    # DDIM is first order in the number of steps.
    torch.testing.assert_close(
        sdi_gradient(prior, PriorQuery(picture, hole, T), steps=150), expected, rtol=0, atol=0.01
    )
    offset = (picture - fill) * hole
    cosine = torch.cosine_similarity(
        sdi_gradient(prior, PriorQuery(picture, hole, T), steps=20).flatten(), offset.flatten(), dim=0
    )
    assert cosine > 0.99


def test_interval_matching_is_the_closed_form_of_gaussians(prior, picture, hole) -> None:
    """ISM: both points lie on the flow of the null condition, N(0, d^2)."""
    d, interval = prior.spec.residual_bands[0], 0.1
    before = T - interval
    (a, s), (a_s, s_s) = _levels(T), _levels(before)
    a0, s0 = _levels(torch.full_like(T, T_FLOOR))
    z_s = picture * ((a_s**2 * d**2 + s_s**2) / (a0**2 * d**2 + s0**2)).sqrt()
    eps_s = _noise_of(z_s, before, torch.zeros_like(z_s), d)
    z_t = a * (z_s - s_s * eps_s) / a_s + s * eps_s
    null, cond = _noise_of(z_t, T, torch.zeros_like(z_t), d), _noise_of(z_t, T, prior.fill_hole(picture, hole), d)
    expected = s**2 * (null + 2.0 * (cond - null) - eps_s) * hole
    gradient = ism_gradient(prior, PriorQuery(picture, hole, T), guidance=2.0, steps=150, interval=interval)
    torch.testing.assert_close(gradient, expected, rtol=0, atol=0.02)


def test_a_dataset_pulls_to_its_picture_until_it_is_updated(prior, picture, hole) -> None:
    target = denoised_target(prior, PriorQuery(picture, hole, T, _eps()), steps=4)
    x = picture
    for _ in range(40):
        x = x - 0.2 * dataset_gradient(x, hole, target)
    torch.testing.assert_close(x, target, rtol=0, atol=1e-3)
    assert torch.equal(
        denoised_target_gradient(prior, PriorQuery(picture, hole, T, _eps())), dataset_gradient(picture, hole, target)
    )


def _variational(prior, query, **options) -> torch.Tensor:
    copy = LowRankCopy(prior)
    copy.learn(query.x, query.mask, torch.Generator().manual_seed(0), (0.1, 0.9))
    return vsd_gradient(prior, copy.network, query, **options)


@pytest.mark.parametrize(
    "gradient_of", [sds_gradient, nfsd_gradient, sdi_gradient, ism_gradient, _variational, denoised_target_gradient]
)
@pytest.mark.parametrize("guidance", [1.0, 4.0])
def test_no_gradient_flows_through_prior_or_condition(gradient_of, guidance, prior, picture, hole) -> None:
    theta = picture.clone().requires_grad_()
    x = torch.tanh(theta)
    gradient = gradient_of(prior, PriorQuery(x, hole, T, _eps()), guidance=guidance)
    assert not gradient.requires_grad
    x.backward(gradient)
    assert theta.grad is not None
    # dx/dtheta alone: were y = (1 - M) x or z_t differentiated, known pixels would move too.
    torch.testing.assert_close(theta.grad, gradient * (1 - x.detach() ** 2))
    assert torch.equal(theta.grad * (1 - hole), torch.zeros_like(theta))
    assert all(parameter.grad is None for parameter in prior.parameters())


def test_the_condition_is_the_rendered_patch_outside_the_hole(prior, picture, hole) -> None:
    known_changed = torch.where(hole > 0, picture, -picture)
    one, two = (sds_gradient(prior, PriorQuery(x, hole, T, _eps())) for x in (picture, known_changed))
    assert (one - two).abs().max() > 1e-3


def test_a_noise_fill_prior_is_shown_its_noise(paper_like, picture, hole) -> None:
    prior = InpaintingPrior(paper_like)
    gradient = sds_gradient(prior, PriorQuery(picture, hole, T, _eps(), noise_fill=_eps(1)))
    # Untrained, eps_hat is 0: the gradient is -w eps M.
    torch.testing.assert_close(gradient, -(per_image(sigma(T)) ** 2) * _eps() * hole)
