import pytest
import torch

from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.diffusion.judging import draw_grid, fill_batch_telea, fill_each_way, hole_psnr
from inpaint3d.diffusion.prior import InpaintingPrior


def test_hole_psnr_looks_at_the_hole_alone(picture, hole) -> None:
    # Off by 0.2 of a range of 2: 20 dB, whatever happens outside.
    filled = picture + torch.where(hole > 0, 0.2, 5.0)
    assert hole_psnr(filled, picture, hole).tolist() == pytest.approx([20, 20], abs=1e-3)


def test_a_batch_is_filled_picture_by_picture(picture, hole) -> None:
    filled = fill_batch_telea(picture, hole)
    for index in range(len(picture)):
        one = fill_telea((picture[index].permute(1, 2, 0).numpy() + 1) / 2, hole[index, 0].numpy() > 0)
        torch.testing.assert_close(filled[index], 2 * torch.from_numpy(one).permute(2, 0, 1) - 1)


def test_an_untrained_residual_prior_expects_the_pyramid(shipped_like, picture, hole) -> None:
    prior = InpaintingPrior(shipped_like)
    filled = fill_each_way(prior, picture, hole, torch.Generator().manual_seed(0), steps=4)
    psnr = {name: hole_psnr(fill, picture, hole).mean().item() for name, fill in filled.items()}
    # At t = 1 the clamp lets 4.5e-5 of the picture through: nothing to see.
    assert psnr["expectation"] == pytest.approx(psnr["pyramid"], abs=0.01)
    assert psnr["sample"] < psnr["expectation"]
    assert draw_grid(picture, hole, filled["sample"]).shape == (2 * 18, 3 * 18, 3)
