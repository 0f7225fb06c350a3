import numpy as np
import pytest

from inpaint3d import kernels


def adam(param, grad, m, v, step, lr, beta1, beta2, eps, decay):
    """Algorithm 1 of arXiv:1412.6980, in float64; line 4 with f(param) + decay / 2 * param^2."""
    grad = grad + decay * param
    m = beta1 * m + (1 - beta1) * grad
    v = beta2 * v + (1 - beta2) * grad**2
    return param - lr * (m / (1 - beta1**step)) / (np.sqrt(v / (1 - beta2**step)) + eps), m, v


@pytest.mark.parametrize("isa", kernels.isas())
@pytest.mark.parametrize("count", [0, 1, 31, 70001])
@pytest.mark.parametrize("decay", [0.0, 1e-3])
def test_twenty_steps_follow_the_algorithm(isa, count, decay):
    rng = np.random.default_rng(count)
    state = [rng.standard_normal(count), np.zeros(count), np.zeros(count)]
    param, m, v = (np.array(part, np.float32) for part in state)
    before = kernels.isa()
    kernels.set_isa(isa)
    for step in range(1, 21):
        # Gradients over twelve decades: the step's size must not depend on theirs.
        grad = (rng.standard_normal(count) * 10.0 ** rng.integers(-12, 1, count)).astype(np.float32)
        kernels.adam(param, grad, m, v, (step, 1e-2, 0.9, 0.99, 1e-15, decay, False), threads=2)
        state = list(adam(state[0], grad.astype(np.float64), *state[1:], step, 1e-2, 0.9, 0.99, 1e-15, decay))
    kernels.set_isa(before)
    np.testing.assert_allclose(param, state[0], atol=2e-6)  # 20 roundings of numbers up to 4
    np.testing.assert_allclose(v, state[2], rtol=1e-5)


@pytest.mark.parametrize("isa", kernels.isas())
@pytest.mark.parametrize("sparse", [False, True])
def test_numbers_without_a_usable_gradient_are_left_alone(isa, sparse):
    rng = np.random.default_rng(0)
    param, m, v, grad = rng.random((4, 200_003), np.float32)
    grad[rng.random(len(grad)) < 0.9] = 0
    grad[[0, 17, 70_000, 200_002]] = np.inf, np.nan, -np.inf, np.nan
    before = [part.copy() for part in (param, m, v)]
    used = kernels.isa()
    kernels.set_isa(isa)
    settings = {"lr": 1e-2, "beta1": 0.9, "beta2": 0.99, "eps": 1e-15, "decay": 1e-3}
    lost = kernels.adam(param, grad, m, v, (3, *settings.values(), sparse), threads=2)
    kernels.set_isa(used)
    assert lost == 4
    moves = np.isfinite(grad) & ((grad != 0) | (not sparse))
    exact = adam(before[0], np.where(moves, grad, 0).astype(np.float64), *before[1:], 3, **settings)
    for part, start, truth in zip((param, m, v), before, exact, strict=True):
        np.testing.assert_array_equal(part[~moves], start[~moves])
        np.testing.assert_allclose(part[moves], truth[moves], atol=1e-6)


def test_sizes_must_agree_and_steps_count_from_one():
    three, four = np.zeros(3, np.float32), np.zeros(4, np.float32)
    settings = (1e-2, 0.9, 0.99, 1e-15, 0.0, False)
    with pytest.raises(ValueError, match="same size"):
        kernels.adam(three, four, three, three, (1, *settings))
    with pytest.raises(ValueError, match="count from 1"):
        kernels.adam(three, three, three, three, (0, *settings))
