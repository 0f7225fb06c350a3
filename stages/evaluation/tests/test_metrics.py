import numpy as np
import pytest
from skimage.metrics import structural_similarity

from inpaint3d.stages.evaluation.metrics import psnr, ssim, ssim_map


def pictures(seed: int = 0, shape: tuple[int, int, int] = (24, 31, 3)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = rng.random(shape, dtype=np.float32)
    return a, np.clip(a + rng.normal(0, 0.1, shape), 0, 1).astype(np.float32)


@pytest.mark.parametrize("shift", [1e-3, 1e-2, 0.1, 0.5])
def test_psnr_of_a_constant_shift_is_twenty_decades_of_it(shift):
    truth = np.full((8, 9, 3), 0.25, np.float32)
    assert psnr(truth + np.float32(shift), truth) == pytest.approx(-20 * np.log10(shift), abs=1e-3)


def test_psnr_of_equal_pictures_stops_at_a_hundred():
    a, _ = pictures()
    assert psnr(a, a) == 100.0


def test_psnr_looks_only_at_its_region():
    a, b = pictures()
    region = np.zeros(a.shape[:2], bool)
    region[3:9, 4:20] = True
    changed = b.copy()
    changed[~region] = 0.0
    assert psnr(changed, a, region) == psnr(b, a, region)
    with pytest.raises(ValueError, match="no pixel"):
        psnr(a, b, np.zeros(a.shape[:2], bool))


@pytest.mark.parametrize("shift", [0.05, 0.2, 0.6])
def test_ssim_of_a_constant_shift_is_its_luminance_term(shift):
    truth = np.full((20, 20, 3), 0.3, np.float32)
    other = truth + np.float32(shift)
    x, y, c1 = 0.3 + shift, 0.3, 1e-4
    assert ssim(other, truth) == pytest.approx((2 * x * y + c1) / (x * x + y * y + c1), rel=1e-5)


def test_ssim_is_the_published_one():
    a, b = pictures()
    peer = structural_similarity(
        a, b, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, channel_axis=-1
    )
    assert ssim(a, b) == pytest.approx(peer, abs=1e-6)


def test_ssim_over_a_region_ignores_windows_that_do_not_touch_it():
    a, b = pictures()
    changed = b.copy()
    changed[:, 20:] = 0.0
    region = np.zeros(a.shape[:2], bool)
    region[:, :15] = True
    assert ssim(changed, a, region) == ssim(b, a, region)
    assert ssim_map(a, a).min() == pytest.approx(1.0)


def test_pictures_smaller_than_the_window_have_an_ssim():
    a, b = pictures(shape=(5, 7, 3))
    assert 0 < ssim(a, b) < 1


def test_other_shapes_are_refused():
    a, b = pictures()
    with pytest.raises(ValueError, match="same"):
        psnr(a[:-1], b)
