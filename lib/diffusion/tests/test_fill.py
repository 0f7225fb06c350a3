import numpy as np
import pytest
import torch

from inpaint3d.diffusion.fill import fill_telea, pyramid_fill


def _disc(size: int, radius: float) -> torch.Tensor:
    axis = torch.arange(size) - (size - 1) / 2
    return ((axis[:, None] ** 2 + axis[None] ** 2) < radius**2).float()[None, None]


def test_known_pixels_are_kept_and_a_flat_picture_is_filled_flat() -> None:
    image = torch.full((2, 3, 37, 50), 0.25)
    mask = (torch.rand(2, 1, 37, 50, generator=torch.Generator().manual_seed(0)) < 0.6).float()
    torch.testing.assert_close(pyramid_fill(image, mask), image)
    texture = torch.rand(2, 3, 37, 50, generator=torch.Generator().manual_seed(1))
    assert torch.equal(pyramid_fill(texture, mask)[mask.expand_as(texture) == 0], texture[mask.expand_as(texture) == 0])


def test_nothing_under_the_mask_matters_not_even_nan() -> None:
    image = torch.rand(1, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    mask = _disc(32, 9)
    painted = torch.where(mask > 0, torch.nan, image)
    assert torch.equal(pyramid_fill(painted, mask), pyramid_fill(image, mask))


def test_a_ramp_goes_on_inside_the_hole() -> None:
    ramp = torch.linspace(-1, 1, 64).expand(1, 3, 64, 64)
    mask = _disc(64, 12)
    error = (pyramid_fill(ramp, mask) - ramp)[mask.expand_as(ramp) > 0].abs()
    flat = (ramp[mask.expand_as(ramp) > 0] - ramp.mean()).abs()
    # Push-pull only averages, so that it is not exact on a ramp; it must beat a flat fill by far.
    assert error.mean() < 0.3 * flat.mean()


def test_a_picture_that_is_all_hole_becomes_grey() -> None:
    assert torch.equal(pyramid_fill(torch.ones(1, 3, 16, 24), torch.ones(1, 1, 16, 24)), torch.zeros(1, 3, 16, 24))


def test_telea_keeps_known_pixels_and_never_looks_under_the_mask() -> None:
    image = np.random.default_rng(0).random((32, 40, 3), np.float32)
    hole = np.zeros((32, 40), bool)
    hole[10:20, 12:25] = True
    filled = fill_telea(image, hole)
    np.testing.assert_array_equal(filled[~hole], image[~hole])
    np.testing.assert_array_equal(filled, fill_telea(np.where(hole[..., None], 1.0, image).astype(np.float32), hole))


def test_telea_fills_a_flat_picture_flat_to_two_codes() -> None:
    image = np.full((24, 24, 3), 0.3, np.float32)
    hole = np.zeros((24, 24), bool)
    hole[8:14, 8:14] = True
    # Half a code from rounding the picture, the rest from OpenCV, which rounds down on the way in.
    np.testing.assert_allclose(fill_telea(image, hole), 0.3, rtol=0, atol=2 / 255)


@pytest.mark.parametrize("value", [-0.3, 1.2, 3.0])
def test_colours_beyond_what_a_picture_holds_do_not_wrap_round_in_a_fill_by_codes(value):
    image, hole = np.full((16, 16, 3), value, np.float32), np.zeros((16, 16), bool)
    hole[6:10, 6:10] = True
    filled = fill_telea(image, hole)
    np.testing.assert_array_equal(filled[hole], np.clip(value, 0, 1))
    np.testing.assert_array_equal(filled[~hole], np.float32(value))
