import numpy as np
import pytest

from inpaint3d import kernels


def arrays(*shapes):
    rng = np.random.default_rng(0)
    return [rng.standard_normal(shape).astype(np.float32) for shape in shapes]


def run(x, weights, biases, out_grad):
    """Output and gradients of x, the weights and the biases, in float64."""
    acts = [x.astype(np.float64)]
    for layer, weight in enumerate(weights):
        linear = acts[-1] @ weight.T.astype(np.float64) + (biases[layer] if biases else 0)
        acts.append(linear if layer + 1 == len(weights) else np.maximum(linear, 0))
    grad, weight_grads, bias_grads = out_grad.astype(np.float64), [], []
    for layer in reversed(range(len(weights))):
        weight_grads.insert(0, grad.T @ acts[layer])
        bias_grads.insert(0, grad.sum(0))
        grad = grad @ weights[layer] * (acts[layer] > 0 if layer else 1)
    return acts[-1], [grad, *weight_grads, *(bias_grads if biases else [])]


@pytest.mark.parametrize("biased", [False, True])
@pytest.mark.parametrize(
    ("count", "widths"),
    [(0, (3, 2)), (1, (1, 1)), (17, (5, 64, 1)), (193, (7, 33, 19)), (50, (31, 64, 64, 3)), (3, (2, 100, 1))],
)
def test_outputs_and_gradients_follow_the_definition(isa, count, widths, biased):
    depth = len(widths) - 1
    shapes = [(widths[i + 1], widths[i]) for i in range(depth)]
    x, out_grad, *weights = arrays((count, widths[0]), (count, widths[-1]), *shapes)
    biases = arrays(*[(width,) for width in widths[1:]]) if biased else []
    truth, exact = run(x, weights, biases, out_grad)

    out = np.full((count, widths[-1]), np.nan, np.float32)
    kernels.mlp_forward(x, weights, biases, out, threads=2)
    np.testing.assert_allclose(out, truth, rtol=1e-4, atol=1e-4 * max(1.0, np.abs(truth).max(initial=0)))

    grads = [np.full_like(array, np.nan) for array in (x, *weights, *biases)]
    kernels.mlp_backward(x, weights, biases, out_grad, grads[0], grads[1 : 1 + depth], grads[1 + depth :], threads=2)
    for grad, expected in zip(grads, exact, strict=True):
        np.testing.assert_allclose(grad, expected, atol=1e-4 * max(1.0, np.abs(expected).max(initial=0)), rtol=0)


def test_layers_that_do_not_fit_are_refused():
    x, first, second, out = arrays((4, 3), (5, 3), (2, 6), (4, 2))
    with pytest.raises(ValueError, match="layer 1 takes 6 numbers but is given 5"):
        kernels.mlp_forward(x, [first, second], [], out)
