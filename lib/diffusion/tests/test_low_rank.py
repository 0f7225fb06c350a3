import pytest
import torch

from inpaint3d.diffusion.distillation import PriorQuery, sds_gradient, vsd_gradient
from inpaint3d.diffusion.low_rank import LowRankCopy
from inpaint3d.diffusion.prior import InpaintingPrior

T = torch.tensor([0.35, 0.8])


@pytest.fixture
def prior(shipped_like) -> InpaintingPrior:
    return InpaintingPrior(shipped_like)


def learnt(prior: InpaintingPrior, picture: torch.Tensor, hole: torch.Tensor, steps: int) -> LowRankCopy:
    copy = LowRankCopy(prior, rate=1e-2)
    generator = torch.Generator().manual_seed(0)
    for _ in range(steps):
        copy.learn(picture, hole, generator, (0.3, 0.9))
    return copy


def test_a_copy_is_the_prior_until_it_learns(prior, picture, hole) -> None:
    """VSD with guidance 1 has then nothing to say."""
    eps = torch.randn(picture.shape, generator=torch.Generator().manual_seed(1))
    gradient = vsd_gradient(prior, LowRankCopy(prior).network, PriorQuery(picture, hole, T, eps))
    assert torch.equal(gradient, torch.zeros_like(gradient))


def test_a_copy_that_knows_the_renders_turns_vsd_towards_sds(prior, picture, hole) -> None:
    """eps_copy nears eps for renders of one picture (arXiv:2305.16213, section 3.3), and the prior is left alone."""
    before = [p.clone() for p in prior.parameters()]
    render = picture + 0.5 * hole
    copy = learnt(prior, render, hole, 60).network
    vsd = sds = 0.0
    for seed in range(4):
        eps = torch.randn(picture.shape, generator=torch.Generator().manual_seed(seed))
        a, b = (
            vsd_gradient(prior, copy, PriorQuery(render, hole, T, eps)),
            sds_gradient(prior, PriorQuery(render, hole, T, eps)),
        )
        vsd, sds = vsd + a, sds + b
        assert (b - a).square().sum() < b.square().sum()
    cosine = torch.cosine_similarity(vsd.flatten(), sds.flatten(), dim=0)
    assert cosine > 0.5
    assert all(torch.equal(a, b) for a, b in zip(before, prior.parameters(), strict=True))
    assert all(p.grad is None for p in prior.parameters())


def test_only_a_small_share_of_the_weights_learns(paper_like) -> None:
    prior = InpaintingPrior(paper_like.model_copy(update={"width": 64}))
    copy = LowRankCopy(prior, rank=2)
    assert sum(p.numel() for p in copy.parameters) < 0.1 * sum(p.numel() for p in prior.parameters())


def test_a_restored_copy_goes_on_where_it_was(prior, picture, hole) -> None:
    whole, half = learnt(prior, picture, hole, 4), learnt(prior, picture, hole, 2)
    resumed = LowRankCopy(prior, rate=1e-2, seed=5)
    resumed.restore({name: tensor.clone() for name, tensor in half.state().items()})
    generator = torch.Generator().manual_seed(0)
    for i in range(4):  # the first two only move the stream of random numbers
        (resumed if i > 1 else half).learn(picture, hole, generator, (0.3, 0.9))
    for a, b in zip(whole.parameters, resumed.parameters, strict=True):
        torch.testing.assert_close(a, b)
