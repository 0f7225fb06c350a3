import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import LensModel
from inpaint3d.stages.scene_analysis.lens import corner_displacement


def lens(model, *params):
    return LensModel(model=model, params=params, evidence="test")


def test_a_pinhole_moves_nothing():
    assert corner_displacement(lens("PINHOLE", 500.0, 510.0, 320.0, 240.0)) == 0
    assert corner_displacement(lens("SIMPLE_PINHOLE", 500.0, 320.0, 240.0)) == 0


def test_one_radial_coefficient_moves_the_corner_by_k_r_cubed():
    f, cx, cy, k = 500.0, 300.0, 400.0, 0.02
    r = 1.0  # (300, 400) / 500
    assert corner_displacement(lens("SIMPLE_RADIAL", f, cx, cy, k)) == pytest.approx(f * k * r**3)
    assert corner_displacement(lens("RADIAL", f, cx, cy, k, 0.01)) == pytest.approx(f * (k + 0.01))
    assert corner_displacement(lens("OPENCV", f, f, cx, cy, k, 0.01, 0.0, 0.0)) == pytest.approx(f * (k + 0.01))


def test_tangential_coefficients_are_in_opencvs_order():
    # x' = x + 2 p1 x y + p2 (r^2 + 2 x^2), at x = 0.6, y = 0.8, r = 1.
    moved = corner_displacement(lens("OPENCV", 500.0, 500.0, 300.0, 400.0, 0.0, 0.0, 0.01, 0.0))
    assert moved == pytest.approx(500 * 0.01 * np.hypot(2 * 0.6 * 0.8, 1 + 2 * 0.8**2))


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_displacement_is_in_pixels_and_scales_with_the_picture(size):
    small = corner_displacement(lens("RADIAL", 500.0, 300.0, 400.0, -0.1, 0.02))
    scaled = corner_displacement(lens("RADIAL", 500.0 * size, 300.0 * size, 400.0 * size, -0.1, 0.02))
    assert scaled == pytest.approx(size * small)


def test_a_fisheye_without_coefficients_is_the_equidistant_projection():
    moved = corner_displacement(lens("OPENCV_FISHEYE", 500.0, 500.0, 300.0, 400.0, 0.0, 0.0, 0.0, 0.0))
    assert moved == pytest.approx(500 * (1 - np.arctan(1.0)))


def test_an_unknown_model_is_refused():
    with pytest.raises(BadInputError, match="FOV"):
        corner_displacement(lens("FOV", 500.0, 500.0, 300.0, 400.0, 0.9))
