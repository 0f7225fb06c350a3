import pytest
import torch

from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.diffusion.fill import pyramid_fill
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.schedules import alpha, per_image, sigma


def _awake(spec: PriorSpec) -> InpaintingPrior:
    """A prior whose zero-started layers have moved, as after training."""
    prior = InpaintingPrior(spec, seed=3)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for parameter in prior.parameters():
            parameter.add_(0.1 * torch.randn(parameter.shape, generator=generator))
    return prior.requires_grad_(False)


@pytest.fixture(params=["paper_like", "shipped_like"])
def prior(request) -> InpaintingPrior:
    return _awake(request.getfixturevalue(request.param))


def _noise(seed: int) -> torch.Tensor:
    return torch.randn(2, 3, 16, 16, generator=torch.Generator().manual_seed(seed))


T = torch.tensor([0.3, 0.9])


def test_what_the_image_holds_under_the_mask_is_never_looked_at(prior, picture, hole) -> None:
    marked = torch.where(hole > 0, 123.0, picture)
    z, fill = _noise(0), _noise(1)
    for guidance in (1.0, 4.0):
        one = prior.predict_noise(z, T, picture, hole, guidance=guidance, noise_fill=fill)
        other = prior.predict_noise(z, T, marked, hole, guidance=guidance, noise_fill=fill)
        assert torch.equal(one, other)


def test_known_pixels_do_matter(prior, picture, hole) -> None:
    z, fill = _noise(0), _noise(1)
    one = prior.predict_noise(z, T, picture, hole, noise_fill=fill)
    other = prior.predict_noise(z, T, -picture, hole, noise_fill=fill)
    assert ((one - other) * hole).abs().max() > 1e-3


def test_guidance_is_null_plus_g_times_the_difference(prior, picture, hole) -> None:
    z, fill = _noise(0), _noise(1)
    null = prior.predict_noise(z, T, torch.zeros_like(picture), torch.ones_like(hole), noise_fill=fill)
    conditional = prior.predict_noise(z, T, picture, hole, noise_fill=fill)
    for guidance in (0.0, 1.0, 2.0, 8.0):
        guided = prior.predict_noise(z, T, picture, hole, guidance=guidance, noise_fill=fill)
        torch.testing.assert_close(guided, null + guidance * (conditional - null))


def test_the_null_condition_of_a_noise_fill_prior_is_pure_noise(paper_like, picture, hole) -> None:
    prior = InpaintingPrior(paper_like)
    fill = _noise(1)
    assert torch.equal(prior.fill_hole(picture, torch.ones_like(hole), fill), fill)
    with pytest.raises(ValueError, match="noise_fill"):
        prior.fill_hole(picture, hole)


def test_the_fill_of_a_mask_channel_prior_is_the_pyramid(shipped_like, picture, hole) -> None:
    assert torch.equal(InpaintingPrior(shipped_like).fill_hole(picture, hole), pyramid_fill(picture, hole))


def test_a_clean_prior_knows_its_known_pixels(shipped_like, picture, hole) -> None:
    eps = _noise(2)
    z = per_image(alpha(T)) * picture + per_image(sigma(T)) * eps
    estimate = _awake(shipped_like).estimate(z, T, picture, hole)
    known = (1 - hole).expand_as(picture) > 0
    assert torch.equal(estimate.clean[known], picture[known])
    # (z - alpha x) / sigma cancels a few digits of float32.
    torch.testing.assert_close(estimate.noise[known], eps[known], rtol=0, atol=1e-5)


def test_a_clean_prior_is_not_shown_the_noise_on_known_pixels(shipped_like, picture, hole) -> None:
    prior = _awake(shipped_like)
    z = _noise(0)
    other = torch.where(hole > 0, z, _noise(5))
    one, two = (prior.estimate(v, T, picture, hole).clean for v in (z, other))
    assert torch.equal(one, two)


def test_the_same_seed_gives_the_same_prior_and_leaves_the_global_one_alone(shipped_like) -> None:
    before = torch.random.get_rng_state()
    one, same, other = (InpaintingPrior(shipped_like, seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(torch.random.get_rng_state(), before)
    assert all(torch.equal(one[name], same[name]) for name in one)
    assert not torch.equal(one["network.stem.weight"], other["network.stem.weight"])
