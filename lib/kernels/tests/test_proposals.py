import numpy as np
import pytest

from inpaint3d import kernels


@pytest.mark.parametrize("count", [0, 1, 17, 5000])
def test_points_of_any_magnitude_come_into_the_cube(isa, count):
    rng = np.random.default_rng(count)
    points = rng.standard_normal((count, 3)) * 10 ** rng.uniform(-3, 30, (count, 1))
    points = points.astype(np.float32)
    length = np.maximum(np.linalg.norm(points.astype(np.float64), axis=1, keepdims=True), 1)
    out = np.full_like(points, np.nan)
    kernels.unit_cube(points, out, threads=2)
    np.testing.assert_allclose(out, (points * (2 - 1 / length) / length / 2 + 1) / 2, rtol=0, atol=2e-7)


def test_the_unit_ball_is_kept_exactly_and_nan_shows(isa):
    points = np.array([[0.5, -0.25, 0.125], [0, 0, 0], [np.nan, 0, 0]], np.float32)
    out = np.empty_like(points)
    kernels.unit_cube(points, out)
    np.testing.assert_array_equal(out[:2], (points[:2] / 2 + 1) / 2)
    assert np.isnan(out[2]).all()


def histogram(rng, rays, n):
    ends = np.sort(rng.random((rays, n + 1), np.float32), 1)
    return ends, rng.random((rays, n), np.float32) / n


def interlevel(ends, weights, other_ends, other_weights):
    """Loss and gradient of each ray (Mip-NeRF 360, arXiv:2111.12077, eq. 13), in float64."""
    overlap = (other_ends[:, None, 1:] > ends[:, :-1, None]) & (other_ends[:, None, :-1] < ends[:, 1:, None])
    weights = weights.astype(np.float64)
    lacking = np.maximum(weights - (overlap * other_weights[:, None].astype(np.float64)).sum(-1), 0)
    scale = weights + np.finfo(np.float32).eps
    return (lacking**2 / scale).sum(-1), -(2 * (lacking / scale)[..., None] * overlap).sum(1)


@pytest.mark.parametrize(("rays", "n", "m"), [(0, 3, 4), (1, 1, 1), (9, 24, 48), (300, 33, 7)])
def test_the_bound_and_its_gradient_follow_the_definition(isa, rays, n, m):
    rng = np.random.default_rng(n)
    ends, weights = histogram(rng, rays, n)
    other_ends, other_weights = histogram(rng, rays, m)
    other_weights *= 0.5
    truth, slope = interlevel(ends, weights, other_ends, other_weights)
    out = np.full(rays, np.nan, np.float32)
    histograms = kernels.Histogram(ends, weights), kernels.Histogram(other_ends, other_weights)
    kernels.interlevel_forward(*histograms, out, threads=2)
    np.testing.assert_allclose(out, truth, rtol=1e-4, atol=1e-6)
    out_grad = rng.standard_normal(rays).astype(np.float32)
    grad = np.full((rays, m), np.nan, np.float32)
    kernels.interlevel_backward(*histograms, out_grad, grad, threads=2)
    # Differences of sums of up to 33 terms of up to 2.
    np.testing.assert_allclose(grad, slope * out_grad[:, None], rtol=1e-4, atol=1e-4)


def test_histograms_must_fit():
    rng = np.random.default_rng(0)
    (ends, weights), (other_ends, other_weights) = histogram(rng, 3, 4), histogram(rng, 3, 5)
    histograms = kernels.Histogram(ends, weights), kernels.Histogram(other_ends[:, :-1].copy(), other_weights)
    with pytest.raises(ValueError, match="other_ends has the wrong shape"):
        kernels.interlevel_forward(*histograms, np.empty(3, np.float32))
