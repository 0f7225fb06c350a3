import numpy as np
import pytest

from inpaint3d import kernels


def rays(count, samples):
    rng = np.random.default_rng(samples)
    density = (10 ** rng.uniform(-6, 3, (count, samples))).astype(np.float32)
    tdist = np.cumsum(rng.uniform(0, 0.2, (count, samples + 1)), 1).astype(np.float32)
    return density, rng.random((count, samples, 3), np.float32), tdist


def render(density, rgb, tdist):
    """All outputs, in float64 (NeRF, arXiv:2003.08934, eq. 3)."""
    density, rgb, tdist = (array.astype(np.float64) for array in (density, rgb, tdist))
    depth = density * np.diff(tdist)
    before = np.concatenate([np.zeros((len(depth), 1)), np.cumsum(depth, 1)[:, :-1]], 1)
    weights = -np.expm1(-depth) * np.exp(-before)
    middle = (tdist[:, 1:] + tdist[:, :-1]) / 2
    return weights, (weights[..., None] * rgb).sum(1), weights.sum(1), (weights * middle).sum(1)


def outputs(count, samples):
    return [np.full(shape, np.nan, np.float32) for shape in ((count, samples), (count, 3), count, count)]


@pytest.mark.parametrize(("count", "samples"), [(0, 4), (1, 1), (5, 17), (300, 32), (2, 129)])
def test_rendering_and_its_gradient_follow_the_definition(isa, count, samples):
    inputs = rays(count, samples)
    outs = outputs(count, samples)
    kernels.composite_forward(kernels.Samples(*inputs), kernels.Rendered(*outs), threads=2)
    for out, truth in zip(outs, render(*inputs), strict=True):
        np.testing.assert_allclose(out, truth, rtol=2e-5, atol=1e-7)

    rng = np.random.default_rng(1)
    out_grads = [rng.standard_normal(out.shape).astype(np.float32) for out in outs]
    grads = [np.full_like(array, np.nan) for array in inputs[:2]]
    kernels.composite_backward(
        kernels.Samples(*inputs),
        outs[0],
        kernels.Rendered(*out_grads),
        kernels.SampleGradients(*grads),
        threads=2,
    )

    def loss(density, rgb):
        return sum(
            float((out * grad).sum()) for out, grad in zip(render(density, rgb, inputs[2]), out_grads, strict=True)
        )

    for which in range(2):  # along one random direction, by central differences in float64
        point = [array.astype(np.float64) for array in inputs[:2]]
        direction = rng.standard_normal(point[which].shape) * (point[which] if which == 0 else 1)
        ends = []
        for sign in (1, -1):
            moved = list(point)
            moved[which] = point[which] + sign * 1e-5 * direction
            ends.append(loss(*moved))
        along = float((grads[which] * direction).sum())
        assert along == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=1e-3, abs=1e-4 * max(1, count))


@pytest.mark.parametrize("jittered", [False, True])
@pytest.mark.parametrize(("n", "count"), [(1, 2), (4, 33), (64, 16)])
def test_resampling_inverts_the_distribution(isa, n, count, jittered):
    rng = np.random.default_rng(n)
    sdist = np.sort(rng.random((20, n + 1), np.float32), 1)
    weights = rng.random((20, n), np.float32) + 0.1
    jitter = rng.random((20, count), np.float32) if jittered else None
    out = np.full((20, count + 1), np.nan, np.float32)
    kernels.resample(sdist, weights, jitter, out, threads=2)
    for ends, mass, place, drawn in zip(sdist, weights, jitter if jittered else [0.5] * 20, out, strict=True):
        cdf = np.concatenate([[0], np.cumsum(mass, dtype=np.float64)])
        centres = np.interp((np.arange(count) + place) / count, cdf / cdf[-1], ends)
        np.testing.assert_allclose(drawn[1:-1], (centres[1:] + centres[:-1]) / 2, atol=1e-5)
        assert ends[0] <= drawn[0] <= drawn[1]
        assert drawn[-2] <= drawn[-1] <= ends[-1]


def test_shapes_must_agree():
    density, rgb, tdist = rays(3, 4)
    with pytest.raises(ValueError, match="samples \\+ 1"):
        kernels.composite_forward(kernels.Samples(density, rgb, tdist[:, :-1].copy()), kernels.Rendered(*outputs(3, 4)))
