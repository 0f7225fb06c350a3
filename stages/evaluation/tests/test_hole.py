import numpy as np
import pytest

from inpaint3d.stages.evaluation.baselines import ring_around
from inpaint3d.stages.evaluation.hole import gradient_ratio, gradient_share, opacity_figures, reprojection_figures


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


@pytest.mark.parametrize("gain", [0.3, 1.0, 2.0])
def test_the_share_of_the_truth_s_gradients_looks_at_the_hole_alone(gain):
    y, x = np.mgrid[:30, :30]
    truth = ((x + y) % 2).astype(np.float32)[..., None] * np.ones(3, np.float32) * 0.2
    noise = np.random.default_rng(0).random((30, 30, 3)).astype(np.float32)
    image = np.where(mask()[..., None], gain * truth, noise)
    assert gradient_share(image, truth, mask()) == pytest.approx(gain**2, rel=1e-5)
    assert gradient_share(image, np.zeros_like(truth), mask()) is None


def test_reprojection_counts_hole_and_known_pixels_apart_and_only_where_seen():
    image = np.zeros((30, 30, 3), np.float32)
    neighbour = np.where(mask()[..., None], np.float32(0.2), np.float32(0.05)) * np.ones(3, np.float32)
    seen = np.ones((30, 30), bool)
    seen[10:15] = False
    neighbour[10:15] = 1.0  # not seen: must not count
    figures = reprojection_figures(image, neighbour, seen, mask(), ~mask())
    assert figures == pytest.approx({"reprojection_hole": 0.2, "reprojection_known": 0.05})
    assert reprojection_figures(image, neighbour, ~mask(), mask(), ~mask()).keys() == {"reprojection_known"}
