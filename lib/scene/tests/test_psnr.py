import math

import numpy as np
import pytest

from inpaint3d.scene.psnr import mean_psnr, psnr

TRUTH = np.random.default_rng(0).uniform(0.2, 0.8, (6, 7, 3)).astype(np.float32)


@pytest.mark.parametrize("shift", [0.1, 1e-3, 1e-6])
def test_a_shift_has_its_decibels(shift):
    truth = np.zeros((4, 5, 3))
    assert psnr(truth + shift, truth) == pytest.approx(-20 * math.log10(shift))


def test_equal_pictures_are_infinite_and_only_there():
    other = TRUTH.copy()
    other[2, 3, 1] = np.nextafter(other[2, 3, 1], np.float32(1))
    region = np.zeros((6, 7), bool)
    region[4:] = True
    assert psnr(TRUTH, TRUTH) == psnr(other, TRUTH, region) == math.inf
    assert 100 < psnr(other, TRUTH) < 200


def test_rows_of_colours_are_compared_as_pictures_are():
    other = np.clip(TRUTH + 0.1, 0, 1)
    region = TRUTH[..., 0] > 0.5
    assert psnr(other[region], TRUTH[region]) == psnr(other, TRUTH, region)


@pytest.mark.parametrize(
    ("image", "region", "said"),
    [(TRUTH[:5], None, "of one shape"), (TRUTH, np.zeros((6, 7), bool), "the region is empty")],
)
def test_nothing_to_compare_is_refused(image, region, said):
    with pytest.raises(ValueError, match=said):
        psnr(image, TRUTH, region)


def test_a_view_that_equals_the_truth_is_not_in_the_mean():
    assert mean_psnr([20.0, math.inf, 30.0]) == 25.0
    assert mean_psnr([math.inf, math.inf]) is None
    assert mean_psnr([]) is None
    assert math.isnan(mean_psnr([20.0, math.nan, math.inf]) or 0.0)
