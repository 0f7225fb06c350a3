import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import torch

from inpaint3d.diffusion.masks import random_masks
from inpaint3d.diffusion.schedules import cosine_time_of
from inpaint3d.diffusion.training import (
    Batch,
    TrainingState,
    begin,
    denoising_loss,
    load_checkpoint,
    rate_after_warm_up,
    save_checkpoint,
    stand_in_for,
    step_generators,
    train_step,
)


def _step(state: TrainingState, pictures: torch.Tensor) -> float:
    rng, generator = step_generators(5, state.step)
    image = pictures[torch.from_numpy(rng.integers(len(pictures), size=4))]
    hole = torch.from_numpy(random_masks(4, 16, rng)).float()[:, None]
    batch = Batch(image, hole, torch.ones_like(hole))
    return train_step(state, lambda prior: denoising_loss(prior, batch, generator), learning_rate=2e-3, ema=0.9)


def test_a_run_that_was_killed_goes_on_as_if_it_had_not_been(shipped_like, picture, tmp_path: Path) -> None:
    unbroken = begin(shipped_like, seed=0)
    losses = [_step(unbroken, picture) for _ in range(7)]

    killed = begin(shipped_like, seed=0)
    first = [_step(killed, picture) for _ in range(2)]
    killed.close_row(held_out_loss=0.5)
    first.append(_step(killed, picture))
    save_checkpoint(tmp_path / "checkpoint.safetensors", killed)
    resumed = begin(shipped_like, seed=99)
    load_checkpoint(tmp_path / "checkpoint.safetensors", resumed)
    assert resumed.curve == [(2, pytest.approx(np.mean(losses[:2])), 0.5)]
    assert resumed.pending == losses[2:3]
    assert first + [_step(resumed, picture) for _ in range(4)] == losses
    for ours, theirs in ((resumed.prior, unbroken.prior), (resumed.average, unbroken.average)):
        for name, weight in ours.state_dict().items():
            assert torch.equal(weight, theirs.state_dict()[name]), name


def test_gradients_of_the_parts_add_up_to_those_of_the_whole(shipped_like, picture, hole) -> None:
    def loss(i: int):
        batch = Batch(picture[i : i + 1], hole[:1], torch.ones_like(hole[:1]))
        return lambda prior: denoising_loss(prior, batch, torch.Generator().manual_seed(i))

    whole, parts = begin(shipped_like, seed=0), begin(shipped_like, seed=0)
    one = train_step(whole, lambda prior: (loss(0)(prior) + loss(1)(prior)) / 2, learning_rate=1e-3)
    assert train_step(parts, loss(0), loss(1), learning_rate=1e-3) == pytest.approx(one)
    for mine, other in zip(parts.prior.parameters(), whole.prior.parameters(), strict=True):
        if other.grad is not None:
            torch.testing.assert_close(mine.grad, other.grad, rtol=1e-4, atol=1e-7)


def test_channels_last_learns_the_same_and_resumes_exactly(shipped_like, picture, tmp_path: Path) -> None:
    plain, last = begin(shipped_like, seed=0), begin(shipped_like, seed=0, channels_last=True)
    assert last.prior.network.stem.weight.is_contiguous(memory_format=torch.channels_last)
    losses = [_step(last, picture) for _ in range(3)]
    # Other convolution kernels: sums in another order.
    assert losses == pytest.approx([_step(plain, picture) for _ in range(3)], rel=1e-3)
    save_checkpoint(tmp_path / "checkpoint.safetensors", last)
    resumed = begin(shipped_like, seed=9, channels_last=True)
    load_checkpoint(tmp_path / "checkpoint.safetensors", resumed)
    assert [_step(resumed, picture) for _ in range(2)] == [_step(last, picture) for _ in range(2)]


def test_damaged_checkpoints_are_never_gone_on_from(shipped_like, picture, tmp_path: Path) -> None:
    """A flipped bit would be another result under the same key, a cut file an error for ever."""
    path, state = tmp_path / "checkpoint.safetensors", begin(shipped_like, seed=0)
    for _ in range(2):
        _step(state, picture)
        save_checkpoint(path, state)
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    path.write_bytes(data)
    resumed = begin(shipped_like, seed=0)
    assert load_checkpoint(path, resumed)
    assert resumed.step == 1, "the generation before"
    (tmp_path / "checkpoint.previous.safetensors").write_bytes(data[:100])
    anew = begin(shipped_like, seed=0)
    assert not load_checkpoint(path, anew)
    assert anew.step == 0


def test_a_checkpoint_of_another_architecture_is_refused(shipped_like, paper_like, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "checkpoint.safetensors", begin(paper_like, seed=0))
    with pytest.raises(ValueError, match="another architecture"):
        load_checkpoint(tmp_path / "checkpoint.safetensors", begin(shipped_like, seed=0))


@pytest.mark.parametrize("spec", ["paper_like", "shipped_like"])
def test_training_lowers_the_loss(spec, request, picture) -> None:
    state = begin(request.getfixturevalue(spec), seed=0)
    losses = [_step(state, picture) for _ in range(60)]
    assert np.mean(losses[-20:]) < 0.9 * np.mean(losses[:20])


@pytest.mark.parametrize(
    ("spec", "prediction"),
    [("paper_like", "eps"), ("paper_like", "v"), ("shipped_like", "x0"), ("shipped_like", "residual")],
)
def test_pixels_that_must_not_be_learnt_change_no_gradient(spec, prediction, request, picture, hole) -> None:
    """The leak rule, where it would break first: a pixel with teach = 0 lies in the hole and is marked."""
    spec = request.getfixturevalue(spec).model_copy(update={"prediction": prediction})
    gradients = []
    for marker in (0.0, 0.77):
        prior = begin(spec, seed=0).prior
        torch.nn.init.normal_(prior.network.head.weight, std=0.1, generator=torch.Generator().manual_seed(0))
        teach = torch.ones_like(hole)
        teach[:, :, 6:9, 6:9] = 0
        batch = Batch(torch.where(teach > 0, picture, marker), hole, teach)
        denoising_loss(prior, batch, torch.Generator().manual_seed(1)).backward()
        gradients.append([p.grad for p in prior.parameters() if p.grad is not None])
    assert len(gradients[0]) > 20
    assert all(torch.equal(a, b) for a, b in zip(*gradients, strict=True))


def test_an_untrained_residual_prior_has_the_loss_of_its_gaussian(shipped_like) -> None:
    """Pictures drawn as N(0, d^2) about a grey surround: the error of the linear guess is its own unit."""
    spec = shipped_like.model_copy(update={"condition_dropout": 0.0})
    generator = torch.Generator().manual_seed(0)
    hole = torch.zeros(64, 1, 16, 16)
    hole[:, :, 4:12, 4:12] = 1
    image = hole * spec.residual_bands[0] * torch.randn(64, 3, 16, 16, generator=generator)
    loss = denoising_loss(begin(spec, seed=0).prior, Batch(image, hole, torch.ones_like(hole)), generator)
    # 12,288 values: known to 1.3 %.
    assert loss.item() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("schedule", ["linear", "shifted"])
def test_a_schedule_says_which_noise_levels_are_learnt(schedule, paper_like, picture, hole) -> None:
    def loss(spec, t: float) -> float:
        prior = begin(spec, seed=0).prior
        torch.nn.init.normal_(prior.network.head.weight, std=0.1, generator=torch.Generator().manual_seed(0))
        batch = Batch(picture, hole, torch.ones_like(hole))
        return denoising_loss(prior, batch, torch.Generator().manual_seed(1), (t, t)).item()

    scheduled_spec = paper_like.model_copy(update={"schedule": schedule})
    same_noise = cosine_time_of(torch.tensor(0.5), schedule, paper_like.size).item()
    assert loss(scheduled_spec, 0.5) == pytest.approx(loss(paper_like, same_noise), rel=1e-5)
    assert loss(scheduled_spec, 0.5) != pytest.approx(loss(paper_like, 0.5), rel=1e-3)


def test_a_step_without_a_finite_gradient_changes_no_weight(shipped_like, picture) -> None:
    state = begin(shipped_like, seed=0)
    _step(state, picture)
    before = {name: weight.clone() for name, weight in state.prior.state_dict().items()}
    loss = train_step(state, lambda p: next(p.parameters()).sum() * torch.nan, learning_rate=1e-3)
    assert np.isnan(loss)
    assert state.step == 2
    assert all(torch.equal(weight, before[name]) for name, weight in state.prior.state_dict().items())


def test_the_average_forgets_the_start_early_and_follows_slowly_later(shipped_like) -> None:
    state = begin(shipped_like, seed=0)
    target = torch.ones_like(state.prior.network.stem.weight)
    with torch.no_grad():
        state.prior.network.stem.weight.copy_(target)
    train_step(state, lambda p: 0.0 * sum(w.sum() for w in p.parameters()), learning_rate=0.0)
    start = begin(shipped_like, seed=0).average.network.stem.weight
    # Decay of the first step: 2 / 11.
    torch.testing.assert_close(state.average.network.stem.weight, 2 / 11 * start + 9 / 11 * target)


def test_the_learning_rate_rises_then_falls_to_its_share() -> None:
    rates = [rate_after_warm_up(1e-3, step, 100, 10) for step in range(101)]
    assert rates[0] == pytest.approx(1e-4)
    assert max(rates) == pytest.approx(1e-3)
    assert rates[100] == pytest.approx(1e-4)
    assert all(late <= early for early, late in itertools.pairwise(rates[10:]))
    assert rate_after_warm_up(1e-3, 150, 100, 10) == rates[100], "beyond the schedule it stays"
    assert rate_after_warm_up(1e-3, 10, 10, 10) == 1e-3, "all of it warm-up: the peak"


def test_a_row_of_the_curve_leaves_out_what_is_not_finite(shipped_like) -> None:
    state = begin(shipped_like, seed=0)
    state.pending = [1.0, math.inf, math.nan, 2.0]
    state.close_row(0.5)
    assert state.curve == [(0, 1.5, 0.5)]


def test_a_picture_that_teaches_nothing_has_no_loss(shipped_like, picture, hole) -> None:
    """And takes none from the other: the mean is over pictures."""
    prior = begin(shipped_like, seed=0).prior
    teach = torch.stack([torch.zeros_like(hole[0]), torch.ones_like(hole[1])])
    hole = torch.maximum(hole, 1 - teach)
    some = denoising_loss(prior, Batch(picture, hole, teach), step_generators(5, 0)[1])
    none = denoising_loss(prior, Batch(picture, hole, torch.zeros_like(teach)), step_generators(5, 0)[1])
    assert 0 < some < math.inf
    assert none == 0


def test_under_the_papers_condition_the_unseen_is_grey_and_the_rest_as_it_is(paper_like, shipped_like, hole) -> None:
    fill = torch.full((2, 3, 16, 16), 0.3)
    grey = stand_in_for(fill, hole, paper_like)
    assert torch.equal(grey, 0.3 * (1 - hole).expand_as(fill))
    assert torch.equal(stand_in_for(fill, hole, shipped_like), fill)
