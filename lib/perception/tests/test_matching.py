import pytest
import torch

from inpaint3d.perception import lpips
from inpaint3d.perception.matching import cells, join_cells, nearest_mismatch, sliced_mismatch

SIDE = 48
HOLE = torch.zeros(SIDE, SIDE, dtype=torch.bool)
HOLE[16:32, 16:32] = True


def stripes(period: int, phase: int = 0) -> torch.Tensor:
    """Red and blue stripes [1, 3, h, w] in [-1, 1]."""
    bar = ((torch.arange(SIDE) + phase) // period % 2).float().expand(SIDE, SIDE) * 2 - 1
    return 0.6 * torch.stack([bar, torch.zeros_like(bar), -bar])[None]


def mismatch(kind: str, made: torch.Tensor, reference: torch.Tensor) -> torch.Tensor:
    sets = cells(made, HOLE, whole=False), cells(reference, torch.ones_like(HOLE), whole=True)
    if kind == "nearest":
        return nearest_mismatch(*sets)
    return sliced_mismatch(*sets, torch.Generator().manual_seed(0))


@pytest.mark.parametrize("kind", ["nearest", "sliced"])
def test_the_scene_s_own_texture_matches_best(kind: str) -> None:
    reference = stripes(4)
    same, shifted = mismatch(kind, reference, reference), mismatch(kind, stripes(4, 2), reference)
    flat = mismatch(kind, torch.where(HOLE, 0.0, reference), reference)
    other = mismatch(kind, torch.where(HOLE, stripes(1), reference), reference)
    assert same <= shifted + 1e-3
    assert shifted < 0.5 * flat
    assert shifted < 0.5 * other


@pytest.mark.parametrize("kind", ["nearest", "sliced"])
def test_descending_the_mismatch_grows_the_texture_into_the_hole(kind: str) -> None:
    reference = stripes(4)
    noise = 0.3 * torch.randn(1, 3, SIDE, SIDE, generator=torch.Generator().manual_seed(1))
    image = torch.where(HOLE, noise, reference)
    first = float(mismatch(kind, image, reference))
    image.requires_grad_()
    optimiser = torch.optim.Adam([image], lr=0.2)
    for _ in range(12):
        optimiser.zero_grad()
        mismatch(kind, image, reference).backward()
        image.grad *= HOLE
        optimiser.step()
    assert float(mismatch(kind, image.detach(), reference)) < 0.5 * first


def test_references_never_look_into_a_hole() -> None:
    """With the hole's reach left out, what the reference holds there changes no feature."""
    seen = [cells(torch.where(HOLE, value, stripes(4)), ~HOLE, whole=True) for value in (-1.0, 1.0)]
    for a, b in zip(*seen, strict=True):
        torch.testing.assert_close(a, b)
    touching = [cells(torch.where(HOLE, value, stripes(4)), ~HOLE, whole=False) for value in (-1.0, 1.0)]
    assert any(not torch.equal(a, b) for a, b in zip(*touching, strict=True))


def test_a_depth_without_references_is_left_out() -> None:
    few = torch.zeros(SIDE, SIDE, dtype=torch.bool)
    few[:12] = True  # conv3_3 reaches further than that
    made, known = cells(stripes(4), HOLE, whole=False), cells(stripes(4), few, whole=True)
    assert len(known[0])
    assert torch.isfinite(nearest_mismatch(made, known))
    assert [len(x) for x in join_cells([known, known])] == [2 * len(x) for x in known]


def test_the_difference_has_a_gradient_and_is_the_distance() -> None:
    a, b = stripes(4).requires_grad_(), stripes(3)
    net = lpips.load("vgg")
    apart = net.difference(torch.nn.functional.interpolate(a, 96), torch.nn.functional.interpolate(b, 96))
    apart.sum().backward()
    assert a.grad is not None
    assert torch.isfinite(a.grad).all()
    assert a.grad.abs().max() > 0
