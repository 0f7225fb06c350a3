import numpy as np
import pytest

from inpaint3d import kernels


def numbers(*shape):
    return np.random.default_rng(sum(shape)).standard_normal(shape).astype(np.float32)


@pytest.mark.parametrize(("count", "rows"), [(0, 2), (33, 1), (60, 4)])
def test_colours_and_gradients_follow_the_definition(isa, count, rows):
    diffuse, specular, exposure = numbers(count, 3), numbers(count, 3) * 2, numbers(rows, 6)
    rgb_grad, scale, padding = numbers(count, 3), 0.5, 0.01
    gain, offset = (np.repeat(part, count // rows, 0) for part in (np.exp(exposure[:, :3]), exposure[:, 3:]))
    both = diffuse + scale * specular
    share = 1 / (1 + np.exp(-(both * gain + offset).astype(np.float64)))
    rgb, shown = np.full_like(diffuse, np.nan), np.full_like(diffuse, np.nan)
    logits, how = kernels.Logits(diffuse, specular, exposure), kernels.ColourMap(scale, padding)
    kernels.colours_forward(logits, how, kernels.Colours(rgb, shown), threads=2)
    np.testing.assert_allclose(rgb, share * (1 + 2 * padding) - padding, rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        shown, (1 + 2 * padding) / (1 + np.exp(-(diffuse * gain + offset))) - padding, rtol=0, atol=1e-6
    )

    grads = [np.full_like(array, np.nan) for array in (diffuse, specular, exposure)]
    kernels.colours_backward(logits, how, kernels.Colours(rgb_grad, None), kernels.Logits(*grads), threads=2)
    slope = rgb_grad * (1 + 2 * padding) * np.maximum(share * (1 - share), 1e-4)
    np.testing.assert_allclose(grads[0], slope * gain, rtol=0, atol=1e-5)
    np.testing.assert_allclose(grads[1], scale * slope * gain, rtol=0, atol=1e-5)
    by_row = np.concatenate([slope * both * gain, slope], 1).reshape(rows, -1, 6).sum(1)
    np.testing.assert_allclose(grads[2], by_row, rtol=0, atol=1e-4)


def test_arrays_must_fit():
    diffuse, out = numbers(6, 3), np.empty((6, 3), np.float32)
    colours, how = kernels.Colours(out, out.copy()), kernels.ColourMap(1.0, 0.0)
    with pytest.raises(ValueError, match="4 exposures do not divide 6 points"):
        kernels.colours_forward(kernels.Logits(diffuse, None, numbers(4, 6)), how, colours)
    with pytest.raises(ValueError, match="specular has the wrong shape"):
        kernels.colours_forward(kernels.Logits(diffuse, numbers(5, 3), None), how, colours)
    with pytest.raises(ValueError, match="specular_grad is for specular"):
        kernels.colours_backward(
            kernels.Logits(diffuse, None, None), how, kernels.Colours(diffuse, None), kernels.Logits(*colours, None)
        )
