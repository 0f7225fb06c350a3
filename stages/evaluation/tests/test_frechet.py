import numpy as np
import pytest

from inpaint3d.stages.evaluation.frechet import frechet_distance, kernel_distance


def vectors(n: int, d: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n, d))


@pytest.mark.parametrize(("n", "d"), [(5, 40), (60, 8)])
def test_equal_sets_are_at_distance_zero(n, d):
    a = vectors(n, d)
    assert frechet_distance(a, a[::-1]) == pytest.approx(0, abs=1e-9 * d * n)


@pytest.mark.parametrize("shift", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize(("n", "d"), [(5, 40), (60, 8)])
def test_a_shifted_set_is_at_the_squared_length_of_the_shift(n, d, shift):
    a = vectors(n, d)
    # the covariance terms cancel to about 1e-13 of their size, d
    assert frechet_distance(a + shift, a) == pytest.approx(d * shift**2, rel=1e-9, abs=1e-11 * d)


@pytest.mark.parametrize("scale", [0.01, 3.0, 100.0])
def test_a_scaled_set_is_at_the_closed_form(scale):
    a = vectors(50, 6)
    a -= a.mean(0)
    total = np.var(a, 0, ddof=1).sum()
    assert frechet_distance(scale * a, a) == pytest.approx((scale - 1) ** 2 * total, rel=1e-9)


def test_independent_covariances_match_the_matrix_square_root():
    a, b = vectors(40, 5), vectors(30, 5, 1) @ np.diag([1, 2, 3, 0.1, 0.5]) + 0.3
    cov_a, cov_b = np.cov(a.T), np.cov(b.T)
    values, axes = np.linalg.eigh(cov_a)
    root = axes @ np.diag(np.sqrt(values)) @ axes.T
    trace = np.sqrt(np.linalg.eigvalsh(root @ cov_b @ root)).sum()
    slow = np.sum((a.mean(0) - b.mean(0)) ** 2) + np.trace(cov_a + cov_b) - 2 * trace
    assert frechet_distance(a, b) == pytest.approx(slow, rel=1e-9)


def test_kernel_distance_has_no_bias():
    """Over many small sets of one distribution the mean is 0 within its standard error; each may be below 0."""
    rng = np.random.default_rng(0)
    values = [kernel_distance(rng.normal(size=(4, 6)), rng.normal(size=(5, 6))) for _ in range(2000)]
    assert min(values) < 0
    assert abs(np.mean(values)) < 4 * np.std(values) / np.sqrt(len(values))


def test_kernel_distance_equals_the_sum_over_pairs():
    a, b = vectors(4, 3), vectors(3, 3, 1) + 1

    def k(x, y):
        return (x @ y / 3 + 1) ** 3

    aa = np.mean([k(x, y) for i, x in enumerate(a) for j, y in enumerate(a) if i != j])
    bb = np.mean([k(x, y) for i, x in enumerate(b) for j, y in enumerate(b) if i != j])
    ab = np.mean([k(x, y) for x in a for y in b])
    assert kernel_distance(a, b) == pytest.approx(aa + bb - 2 * ab)


@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
def test_one_vector_is_no_set(distance):
    with pytest.raises(ValueError, match="at least 2"):
        distance(vectors(1, 4), vectors(5, 4))
