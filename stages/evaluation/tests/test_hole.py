import numpy as np
import pytest

from inpaint3d.stages.evaluation.baselines import ring_around
from inpaint3d.stages.evaluation.hole import gradient_ratio, opacity_figures


def mask() -> np.ndarray:
    out = np.zeros((30, 30), bool)
    out[10:20, 10:20] = True
    return out


def test_opacity_counts_the_inside_alone():
    opacity = np.zeros((30, 30), np.float32)
    opacity[mask()] = 1.0
    opacity[10, 10:20] = 0.5
    figures = opacity_figures(opacity, mask())
    assert figures == {"opacity_mean": 0.95, "opacity_min": 0.5, "opaque_share": 0.9}


@pytest.mark.parametrize("gain", [0.1, 1.0, 3.0])
def test_the_ratio_is_the_square_of_the_contrast(gain):
    y, x = np.mgrid[:30, :30]
    checks = ((x + y) % 2).astype(np.float32)[..., None] * np.ones(3, np.float32) * 0.2
    image = np.where(mask()[..., None], gain * checks, checks)
    assert gradient_ratio(image, mask(), ring_around(mask(), 4)) == pytest.approx(gain**2, rel=1e-5)


def test_a_flat_surround_or_a_hole_of_one_pixel_has_no_ratio():
    flat = np.zeros((30, 30, 3), np.float32)
    assert gradient_ratio(flat, mask(), ring_around(mask(), 3)) is None
    one = np.zeros((30, 30), bool)
    one[3, 3] = True
    assert gradient_ratio(flat, one, ring_around(one, 3)) is None
