import numpy as np
import pytest

from inpaint3d.scene.colour import linear_from_srgb, luma, srgb_from_linear, to_bytes


@pytest.mark.parametrize(
    ("linear", "encoded"), [(0, 0), (1, 1), (0.0031308, 0.04045), (0.2140411, 0.5), (0.18, 0.461356)]
)
def test_published_values(linear, encoded):
    assert float(srgb_from_linear(np.float64(linear))) == pytest.approx(encoded, abs=1e-5)
    assert float(linear_from_srgb(np.float64(encoded))) == pytest.approx(linear, abs=1e-5)


def test_the_curves_are_inverse_over_all_magnitudes():
    x = np.concatenate([[0.0], np.logspace(-12, 0, 200)])
    # The standard's two pieces meet to 1e-8 only.
    np.testing.assert_allclose(linear_from_srgb(srgb_from_linear(x)), x, rtol=1e-6, atol=1e-15)


def test_every_byte_comes_back():
    levels = np.arange(256) / 255
    np.testing.assert_array_equal(to_bytes(srgb_from_linear(linear_from_srgb(levels))), np.arange(256))


def test_outside_values_are_clipped_and_dtype_is_kept():
    for curve in (srgb_from_linear, linear_from_srgb):
        np.testing.assert_allclose(curve(np.array([-1, 2], np.float32)), [0, 1], rtol=1e-6)
    assert srgb_from_linear(np.zeros(2, np.float32)).dtype == np.float32
    assert to_bytes([-0.1, 1.1, 0.5]).tolist() == [0, 255, 128]


def test_luma_of_white_is_one():
    assert luma(np.ones(3)) == pytest.approx(1)
