import pytest
import torch

from inpaint3d.diffusion.bands import band_filter, from_opponent, pixel_variance, to_opponent


def _x(size: int = 16) -> torch.Tensor:
    return torch.randn(2, 3, size, size, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def _one(band: int, bands: int = 4) -> torch.Tensor:
    return torch.eye(bands, dtype=torch.float64)[band, :, None].expand(2, bands, 3)


def test_bands_are_orthogonal_projections_that_sum_to_the_identity() -> None:
    x = _x()
    parts = [band_filter(x, _one(band)) for band in range(4)]
    torch.testing.assert_close(torch.stack(parts).sum(0), x)
    for i, part in enumerate(parts):
        torch.testing.assert_close(band_filter(part, _one(i)), part)
        assert all((part * other).sum().abs() < 1e-10 for j, other in enumerate(parts) if j != i)


def test_bands_are_those_of_the_haar_transform() -> None:
    x = _x(4)
    # One level by hand: the average of each block of 2x2, and what differs from it.
    coarse = x.reshape(2, 3, 2, 2, 2, 2).mean(dim=(3, 5)).repeat_interleave(2, -1).repeat_interleave(2, -2)
    torch.testing.assert_close(band_filter(x, _one(1, 2)), coarse)
    torch.testing.assert_close(band_filter(x, _one(0, 2)), x - coarse)


def test_equal_gains_scale_and_a_single_band_is_white() -> None:
    torch.testing.assert_close(band_filter(_x(), torch.full((2, 4, 3), 0.7).double()), 0.7 * _x())
    torch.testing.assert_close(band_filter(_x(), torch.full((2, 1, 3), 0.5).double()), 0.5 * _x())


def test_filters_of_equal_bands_multiply() -> None:
    g, h = torch.rand(2, 2, 4, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    torch.testing.assert_close(band_filter(band_filter(_x(), g), h), band_filter(_x(), g * h))


def test_each_channel_has_its_own_gains() -> None:
    gains = torch.tensor([[1.0, 0.0, 2.0], [1.0, 3.0, 2.0]], dtype=torch.float64).expand(2, 2, 3)
    filtered = band_filter(_x(), gains)
    torch.testing.assert_close(filtered[:, 0], _x()[:, 0])
    torch.testing.assert_close(filtered[:, 1], 3 * band_filter(_x(), _one(1, 2))[:, 1])
    torch.testing.assert_close(filtered[:, 2], 2 * _x()[:, 2])


def test_opponent_colours_are_a_rotation_whose_first_axis_is_lightness() -> None:
    x = _x()
    torch.testing.assert_close(from_opponent(to_opponent(x)), x)
    torch.testing.assert_close(to_opponent(x).square().sum(1), x.square().sum(1))
    grey = torch.full((1, 3, 2, 2), 0.5, dtype=torch.float64)
    torch.testing.assert_close(to_opponent(grey)[:, 0], torch.full((1, 2, 2), 0.5 * 3**0.5, dtype=torch.float64))
    torch.testing.assert_close(to_opponent(grey)[:, 1:], torch.zeros(1, 2, 2, 2, dtype=torch.float64))


def test_pixel_variance_is_that_of_filtered_noise() -> None:
    spreads = (0.1, 0.25, 0.6)
    noise = torch.randn(1, 3, 512, 512, generator=torch.Generator().manual_seed(0))
    variance = band_filter(noise, torch.tensor(spreads)[None, :, None].expand(1, 3, 3)).var().item()
    # 786,432 samples, of which the coarsest band has 49,152: known to 0.6 %.
    assert variance == pytest.approx(pixel_variance(spreads), rel=0.02)
    assert pixel_variance((0.3,)) == pytest.approx(0.09)


def test_sides_that_do_not_divide_are_refused() -> None:
    with pytest.raises(ValueError, match="multiples of 8"):
        band_filter(torch.zeros(1, 3, 12, 16), torch.ones(1, 4, 3))
