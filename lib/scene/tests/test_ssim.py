import numpy as np
import pytest

from inpaint3d.scene.ssim import ssim, ssim_map


def pictures(seed: int = 0, shape: tuple[int, int, int] = (24, 31, 3)) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    a = rng.random(shape, dtype=np.float32)
    return a, np.clip(a + rng.normal(0, 0.1, shape), 0, 1).astype(np.float32)


@pytest.mark.parametrize("shift", [0.05, 0.2, 0.6])
def test_ssim_of_a_constant_shift_is_its_luminance_term(shift):
    truth = np.full((20, 20, 3), 0.3, np.float32)
    other = truth + np.float32(shift)
    x, y, c1 = 0.3 + shift, 0.3, 1e-4
    assert ssim(other, truth) == pytest.approx((2 * x * y + c1) / (x * x + y * y + c1), rel=1e-5)


def test_ssim_is_the_published_formula_at_a_pixel():
    a, b = pictures()
    offset = np.arange(11) - 5
    window = np.exp(-0.5 * (offset / 1.5) ** 2)
    window = np.outer(window, window) / window.sum() ** 2
    values = []
    for x, y in zip(a[5:16, 8:19].astype(float).transpose(2, 0, 1), b[5:16, 8:19].transpose(2, 0, 1), strict=True):
        mx, my = (window * x).sum(), (window * y).sum()
        vx, vy, cov = (window * x * x).sum() - mx**2, (window * y * y).sum() - my**2, (window * x * y).sum() - mx * my
        values.append((2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4)))
    assert ssim_map(a, b)[10, 13] == pytest.approx(np.mean(values), rel=1e-9)


def test_ssim_over_a_region_ignores_windows_that_do_not_touch_it():
    a, b = pictures()
    changed = b.copy()
    changed[:, 20:] = 0.0
    region = np.zeros(a.shape[:2], bool)
    region[:, :15] = True
    assert ssim(changed, a, region) == ssim(b, a, region)
    assert ssim_map(a, a).min() == pytest.approx(1.0)


@pytest.mark.parametrize("shape", [(5, 7, 3), (40, 3, 3), (1, 1, 3), (10, 30, 3)])
def test_pictures_smaller_than_the_window_are_mirrored_beyond_their_border(shape):
    a, b = pictures(shape=shape)
    beyond = ((16, 16), (16, 16), (0, 0))
    mirrored = ssim_map(np.pad(a, beyond, mode="symmetric"), np.pad(b, beyond, mode="symmetric"))
    np.testing.assert_allclose(ssim_map(a, b), mirrored[16:-16, 16:-16], rtol=1e-12, atol=1e-14)
    assert 0 < ssim(a, b) < 1


def test_other_shapes_are_refused():
    a, b = pictures()
    with pytest.raises(ValueError, match="same"):
        ssim(a[:-1], b)
