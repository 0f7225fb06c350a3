import pytest
import torch

from inpaint3d.diffusion.judging import fills, grid, hole_psnr, telea_fill
from inpaint3d.diffusion.prior import InpaintingPrior


def test_hole_psnr_looks_at_the_hole_alone(picture, hole) -> None:
    # Off by 0.2 of a range of 2: 20 dB, whatever happens outside.
    filled = picture + torch.where(hole > 0, 0.2, 5.0)
    assert hole_psnr(filled, picture, hole).tolist() == pytest.approx([20, 20], abs=1e-3)


def test_telea_keeps_known_pixels_to_a_code_value(picture, hole) -> None:
    known = (1 - hole).expand_as(picture) > 0
    torch.testing.assert_close(telea_fill(picture, hole)[known], picture[known], rtol=0, atol=1 / 255)


def test_an_untrained_residual_prior_expects_the_pyramid(shipped_like, picture, hole) -> None:
    prior = InpaintingPrior(shipped_like)
    filled = fills(prior, picture, hole, torch.Generator().manual_seed(0), steps=4)
    psnr = {name: hole_psnr(fill, picture, hole).mean().item() for name, fill in filled.items()}
    # At t = 1 the clamp lets 4.5e-5 of the picture through: nothing to see.
    assert psnr["expectation"] == pytest.approx(psnr["pyramid"], abs=0.01)
    assert psnr["sample"] < psnr["expectation"]
    assert grid(picture, hole, filled["sample"]).shape == (2 * 18, 3 * 18, 3)
