import numpy as np
import pytest

from inpaint3d import kernels


def arrays(*shapes):
    rng = np.random.default_rng(0)
    return [rng.standard_normal(shape).astype(np.float32) for shape in shapes]


def run(x, weights, starts, out_grad):
    """Output and gradients of x, the weights and the starts, in float64."""
    acts = [x.astype(np.float64)]
    for layer, weight in enumerate(weights):
        linear = acts[-1] @ weight.T.astype(np.float64)
        if layer == 0 and len(starts):
            linear += np.repeat(starts, len(x) // len(starts), 0)
        acts.append(linear if layer + 1 == len(weights) else np.maximum(linear, 0))
    grad, weight_grads = out_grad.astype(np.float64), []
    for layer in reversed(range(len(weights))):
        weight_grads.insert(0, grad.T @ acts[layer])
        sums_grad, grad = grad, grad @ weights[layer] * (acts[layer] > 0 if layer else 1)
    starts_grad = sums_grad.reshape(len(starts), -1, starts.shape[1]).sum(1) if len(starts) else starts
    return acts[-1], [grad, *weight_grads, starts_grad]


@pytest.mark.parametrize(
    ("count", "widths", "runs"),
    [
        (0, (3, 2), 0),
        (1, (1, 1), 1),
        (17, (5, 64, 1), 0),
        (193, (7, 33, 19), 193),
        (50, (31, 64, 64, 3), 5),
        (960, (15, 64, 3), 40),
        (3, (2, 100, 1), 1),
    ],
)
def test_outputs_and_gradients_follow_the_definition(isa, count, widths, runs):
    """runs: how many starts there are; 0: none."""
    depth = len(widths) - 1
    shapes = [(widths[i + 1], widths[i]) for i in range(depth)]
    x, out_grad, starts, *weights = arrays((count, widths[0]), (count, widths[-1]), (runs, widths[1]), *shapes)
    truth, exact = run(x, weights, starts, out_grad)
    network = kernels.Network(x, weights, starts if runs else None)

    out = np.full((count, widths[-1]), np.nan, np.float32)
    kernels.mlp_forward(network, out, threads=2)
    np.testing.assert_allclose(out, truth, rtol=1e-4, atol=1e-4 * max(1.0, np.abs(truth).max(initial=0)))

    grads = [np.full_like(array, np.nan) for array in (x, *weights, starts)]
    grouped = kernels.Network(grads[0], grads[1 : 1 + depth], grads[-1] if runs else None)
    kernels.mlp_backward(network, out_grad, grouped, threads=2)
    for grad, expected in zip(grads, exact, strict=True):
        np.testing.assert_allclose(grad, expected, atol=1e-4 * max(1.0, np.abs(expected).max(initial=0)), rtol=0)


def test_starts_that_do_not_divide_the_rows_or_serve_too_many_are_refused():
    x, weight, out = arrays((400, 3), (2, 3), (400, 2))
    with pytest.raises(ValueError, match="7 starts do not divide 400 rows"):
        kernels.mlp_forward(kernels.Network(x, [weight], np.zeros((7, 2), np.float32)), out)
    with pytest.raises(ValueError, match=f"at most {kernels.MOST_RUN} share a start"):
        kernels.mlp_forward(kernels.Network(x, [weight], np.zeros((1, 2), np.float32)), out)
    with pytest.raises(ValueError, match="as wide as the first layer"):
        kernels.mlp_forward(kernels.Network(x, [weight], np.zeros((4, 3), np.float32)), out)


def test_layers_that_do_not_fit_are_refused():
    x, first, second, out = arrays((4, 3), (5, 3), (2, 6), (4, 2))
    with pytest.raises(ValueError, match="layer 1 takes 6 numbers but is given 5"):
        kernels.mlp_forward(kernels.Network(x, [first, second], None), out)
