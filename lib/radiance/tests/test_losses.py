import dataclasses
import math

import pytest
import torch

from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.backends.reference import outer_measure
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.losses import (
    charbonnier,
    depth_smoothness_loss,
    distortion,
    distortion_loss,
    hash_decay,
    interlevel_loss,
)
from inpaint3d.radiance.rendering import Rendering


def seeded(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def histogram(rays: int, n: int, seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Sorted ends from 0 to 1, and weights that sum to less than 1."""
    ends = torch.cumsum(torch.cat([torch.zeros(rays, 1), seeded(rays, n, seed=seed) + 0.05], -1), -1)
    weights = seeded(rays, n, seed=seed + 1)
    return ends / ends[:, -1:], 0.9 * weights / weights.sum(-1, keepdim=True)


def rendering(
    sdist: torch.Tensor, weights: torch.Tensor, proposals: list[tuple[torch.Tensor, torch.Tensor]]
) -> Rendering:
    r = len(sdist)
    flat, colour = torch.zeros(r), torch.zeros(r, 3)
    return Rendering(colour, colour, flat, flat, flat, weights, sdist, 0.1 + 5 * sdist, proposals)


def test_the_printed_charbonnier_is_a_misprint() -> None:
    residual = torch.tensor([-9e-4, 0.0, 5e-4, 0.5])
    printed = torch.sqrt(residual**2 - 1e-3**2)
    assert printed.isnan().tolist() == [True, True, True, False]
    ours = charbonnier(residual)
    assert torch.isfinite(ours).all()
    torch.testing.assert_close(ours, torch.sqrt(residual**2 + 1e-3**2))


@pytest.mark.parametrize("magnitude", [0.0, *(10.0**e for e in range(-38, 39, 4))])
def test_charbonnier_of_any_magnitude(magnitude: float) -> None:
    residual = torch.tensor([magnitude, -magnitude], requires_grad=True)
    value = charbonnier(residual)
    value.sum().backward()
    assert residual.grad is not None
    torch.testing.assert_close(value, torch.full((2,), math.hypot(magnitude, 1e-3)))
    expected = magnitude / math.hypot(magnitude, 1e-3)
    torch.testing.assert_close(residual.grad, torch.tensor([expected, -expected]))


def test_outer_measure_counts_every_interval_that_overlaps() -> None:
    ends = torch.tensor([[0.0, 0.15, 0.5, 1.0]])
    other_ends, other = torch.tensor([[0.0, 0.1, 0.3, 0.5, 1.0]]), torch.tensor([[0.1, 0.2, 0.3, 0.4]])
    torch.testing.assert_close(outer_measure(ends, other_ends, other), torch.tensor([[0.3, 0.5, 0.4]]))


def test_outer_measure_is_nothing_before_and_behind_the_other_histogram() -> None:
    other_ends, other = torch.tensor([[0.2, 0.4, 0.6]]), torch.tensor([[0.3, 0.5]])
    ends = torch.tensor([[0.0, 0.1, 0.3, 0.7, 0.9]])
    torch.testing.assert_close(outer_measure(ends, other_ends, other), torch.tensor([[0.0, 0.3, 0.8, 0.0]]))


def test_outer_measure_equals_the_double_loop() -> None:
    (ends, _), (other_ends, other) = histogram(4, 6, seed=1), histogram(4, 9, seed=3)
    overlap = (other_ends[:, None, 1:] > ends[:, :-1, None]) & (other_ends[:, None, :-1] < ends[:, 1:, None])
    torch.testing.assert_close(outer_measure(ends, other_ends, other), (overlap * other[:, None]).sum(-1))


def test_a_proposal_that_is_the_histogram_itself_costs_nothing() -> None:
    ends, weights = histogram(5, 8, seed=0)
    assert interlevel_loss(rendering(ends, weights, [(ends, weights)])) < 1e-30  # cumulative sums round
    # a coarser one that sums what it covers bounds it too
    coarse = (ends[:, ::2], weights[:, ::2] + weights[:, 1::2])
    assert interlevel_loss(rendering(ends, weights, [coarse])) < 1e-30


def test_interlevel_loss_is_the_formula_and_moves_the_proposals_alone() -> None:
    (ends, weights), (proposal_ends, proposal) = histogram(5, 8, seed=0), histogram(5, 6, seed=4)
    weights.requires_grad_()
    proposal = (0.5 * proposal).detach().requires_grad_()
    loss = interlevel_loss(rendering(ends, weights, [(proposal_ends, proposal)]))
    lacking = (weights - outer_measure(ends, proposal_ends, proposal)).clamp(min=0)
    torch.testing.assert_close(loss, (lacking**2 / weights).sum(-1).mean(), rtol=1e-12, atol=0)
    loss.backward()
    assert weights.grad is None
    assert proposal.grad is not None
    assert proposal.grad.abs().max() > 0
    assert (proposal.grad <= 0).all()  # more proposal weight never hurts


def test_interlevel_loss_of_empty_rays_is_finite() -> None:
    ends, weights = histogram(3, 8, seed=0)
    proposal = torch.zeros(3, 8, dtype=torch.float64, requires_grad=True)
    loss = interlevel_loss(rendering(ends, weights * 0, [(ends, proposal)]))
    loss.backward()
    assert loss == 0
    assert proposal.grad is not None
    assert torch.isfinite(proposal.grad).all()


def test_distortion_equals_the_double_sum() -> None:
    ends, weights = histogram(4, 9, seed=2)
    middle = (ends[:, 1:] + ends[:, :-1]) / 2
    pairs = (weights[:, :, None] * weights[:, None] * (middle[:, :, None] - middle[:, None]).abs()).sum((1, 2))
    within = (weights**2 * torch.diff(ends)).sum(-1) / 3
    torch.testing.assert_close(distortion(weights, ends), pairs + within)


def test_distortion_of_one_interval_and_of_two() -> None:
    ends = torch.tensor([[0.0, 0.3, 0.5, 1.0]])
    torch.testing.assert_close(distortion(torch.tensor([[0.0, 0.8, 0.0]]), ends), torch.tensor([0.8**2 * 0.2 / 3]))
    two = distortion(torch.tensor([[0.5, 0.0, 0.5]]), ends)
    torch.testing.assert_close(two, torch.tensor([2 * 0.25 * (0.75 - 0.15) + 0.25 * (0.3 + 0.5) / 3]))


def test_distortion_loss_curves_metric_distances() -> None:
    ends, weights = histogram(4, 9, seed=2)
    seen = rendering(ends, weights, [])
    curved = 2 - 2 / (10000.0 * seen.tdist + 1)  # Zip-NeRF's ladder with p = -1, premultiplied by 20000
    torch.testing.assert_close(distortion_loss(seen), distortion(weights, curved).mean(), rtol=1e-7, atol=0)


def test_distortion_loss_is_precise_in_single_precision() -> None:
    ends, weights = histogram(64, 24, seed=5)
    exact = rendering(ends, weights, [])
    single = dataclasses.replace(exact, weights=weights.float(), tdist=exact.tdist.float())
    # The ladder itself would have lost all but a tenth: distances of 1 to 5 differ by 1e-4 below a limit of 2.
    torch.testing.assert_close(distortion_loss(single).double(), distortion_loss(exact), rtol=1e-5, atol=0)


def test_depth_smoothness_is_the_sum_of_squared_steps() -> None:
    depth = seeded(2, 4, 5)
    flat = torch.full((2, 4, 5, 3), 0.3, dtype=torch.float64)
    expected = (torch.diff(depth, dim=1) ** 2).sum() + (torch.diff(depth, dim=2) ** 2).sum()
    torch.testing.assert_close(depth_smoothness_loss(depth, flat), expected / depth.numel())
    assert depth_smoothness_loss(torch.ones(2, 4, 5), torch.rand(2, 4, 5, 3)) == 0


def test_depth_may_break_where_the_colour_does_and_colours_are_not_moved() -> None:
    depth = torch.zeros(1, 4, 4)
    depth[..., 2:] = 1
    edge = torch.zeros(1, 4, 4, 3)
    edge[..., 2:, :] = 1
    flat = torch.zeros(1, 4, 4, 3, requires_grad=True)
    depth.requires_grad_()
    without = depth_smoothness_loss(depth, flat)
    assert depth_smoothness_loss(depth, edge) < 1e-6 * without
    without.backward()
    assert flat.grad is None
    assert depth.grad is not None
    assert depth.grad.abs().max() > 0


def test_hash_decay_is_the_sum_over_levels_of_mean_squares() -> None:
    spec = FieldSpec(
        grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
        proposal_grid=GridSpec(levels=2, coarsest=4, finest=8, log2_table=8, channels=1),
    )
    field = RadianceField(spec, seed=0, backend="reference")
    with torch.no_grad():
        for network in (field.proposal, field.base):
            network.table.copy_(torch.randn(network.table.shape, generator=torch.Generator().manual_seed(0)))
    expected = torch.zeros(())
    for network in (field.proposal, field.base):
        for level in network.levels:
            expected = expected + (network.table[level.offset : level.offset + level.size] ** 2).mean()
    loss = hash_decay(field)
    torch.testing.assert_close(loss, expected.detach())
    loss.backward()
    first = field.base.levels[0]
    assert field.base.table.grad is not None
    # every entry is moved, touched by a ray or not
    torch.testing.assert_close(
        field.base.table.grad[: first.size], 2 * field.base.table.detach()[: first.size] / (first.size * 2)
    )
