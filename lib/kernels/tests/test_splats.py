"""Splats by the kernels alone; `lib/radiance/tests/test_splats.py` has them against the reference in torch."""

import numpy as np
import pytest

from inpaint3d import kernels

WORLD = np.eye(4, dtype=np.float32)[:3].copy()
CAMERA = kernels.Pinhole((20.0, 20.0, 16.0, 12.0), WORLD, 0.05)


def row(mean=(0.0, 0.0, 2.0), scale=0.1, opacity=0.0):
    parts = [mean], [[np.log(scale)] * 3], [[1.0, 0, 0, 0]], [opacity], [[0.5, 0.25, 1.0]]
    return kernels.Splats(*(np.array(part, np.float32) for part in parts))


def pile(*rows):
    return kernels.Splats(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))


def draw(splats, camera=CAMERA):
    rgb = np.full((24, 32, 3), np.nan, np.float32)
    kernels.splats_forward(splats, camera, rgb)
    return rgb


@pytest.mark.usefixtures("isa")
def test_one_splat_is_a_gaussian_cut_at_a_255th():
    x, y = np.arange(32) + 0.5 - 16, np.arange(24) + 0.5 - 12
    variance = (0.1 * 20 / 2) ** 2 + 0.3
    alpha = 0.5 * np.exp(-(x**2 + y[:, None] ** 2) / (2 * variance))
    alpha[alpha < 1 / 255] = 0
    np.testing.assert_allclose(draw(row()), alpha[..., None] * (0.5, 0.25, 1.0), atol=1e-6)


@pytest.mark.usefixtures("isa")
def test_no_splat_is_black():
    empty = kernels.Splats(*(part[:0].copy() for part in row()))
    assert not draw(empty).any()


BROKEN = {0: (np.nan, np.inf, -np.inf, 1e30), 1: (np.nan, np.inf, 1e30), 2: (np.nan, np.inf), 3: (np.nan, -np.inf)}


@pytest.mark.usefixtures("isa")
@pytest.mark.parametrize(("part", "value"), [(part, value) for part, values in BROKEN.items() for value in values])
def test_a_splat_that_is_not_finite_hides_nothing_and_takes_no_gradient(part, value):
    broken = row()
    broken[part][0] = value
    seen = draw(pile(row(), broken))
    grads = kernels.Splats(*(np.full_like(part, np.nan) for part in pile(row(), broken)))
    kernels.splats_backward(pile(row(), broken), CAMERA, seen, np.ones_like(seen), grads)
    np.testing.assert_array_equal(seen, draw(row()))
    assert all(np.isfinite(part).all() and not part[1].any() for part in grads)


@pytest.mark.usefixtures("isa")
@pytest.mark.parametrize("scale", [1e-6, 1e-2, 1.0, 1e3])
def test_a_step_against_the_gradient_lessens_a_loss_at_any_size(scale):
    splats = row(mean=(0.05, -0.03, 2.0), scale=scale)
    seen = draw(splats)
    grads = kernels.Splats(*(np.empty_like(part) for part in splats))
    kernels.splats_backward(splats, CAMERA, seen, 2 * seen, grads)
    length = np.sqrt(sum(np.square(part).sum() for part in grads))
    assert length > 0
    moved = kernels.Splats(*(part - 1e-2 / length * grad for part, grad in zip(splats, grads, strict=True)))
    change = np.square(draw(moved).astype(np.float64)).sum() - np.square(seen.astype(np.float64)).sum()
    assert change == pytest.approx(-1e-2 * length, rel=0.1)


def test_shapes_and_cameras_are_checked():
    short = row()._replace(rgb=np.zeros((2, 3), np.float32))
    with pytest.raises(ValueError, match="rgb has the wrong shape"):
        draw(short)
    with pytest.raises(ValueError, match="near must be positive"):
        draw(row(), CAMERA._replace(near=0.0))
    with pytest.raises(ValueError, match="focal lengths must be positive"):
        draw(row(), CAMERA._replace(intrinsics=(0.0, 1.0, 1.0, 1.0)))
    seen = draw(row())
    with pytest.raises(ValueError, match="rgb_grad has the wrong shape"):
        kernels.splats_backward(row(), CAMERA, seen, seen[:3].copy(), row())
