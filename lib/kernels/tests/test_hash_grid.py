"""The hash grid against a slow float64 version of its definition, on every path of the processor."""

import numpy as np
import pytest

from inpaint3d import kernels

HASHED = [(4, 0, 125, True), (9, 125, 256, False), (31, 381, 256, False)]


def corners_of(point, level):
    """(entry, weight) of the eight corners around one point, in float64."""
    resolution, offset, size, dense = level
    scaled = point.astype(np.float64) * resolution
    low = np.clip(np.floor(scaled), 0, resolution - 1).astype(np.int64)
    for bits in range(8):
        step = np.array([bits & 1, bits >> 1 & 1, bits >> 2])
        x, y, z = (int(i) for i in low + step)
        side = resolution + 1
        index = x + side * (y + side * z) if dense else (x ^ y * 2654435761 ^ z * 805459861) % size
        share = scaled - low
        yield offset + index, float(np.prod(np.where(step == 1, share, 1 - share)))


def encode(points, table, levels):
    rows = [[sum(w * table[i].astype(np.float64) for i, w in corners_of(p, level)) for level in levels] for p in points]
    return np.array(rows).reshape(len(points), len(levels) * table.shape[1])


def table_gradient(points, out_grad, levels, shape):
    grad = np.zeros(shape)
    for point, row in zip(points, out_grad.reshape(len(points), len(levels), shape[1]), strict=True):
        for level, features in zip(levels, row, strict=True):
            for index, weight in corners_of(point, level):
                grad[index] += weight * features
    return grad


@pytest.mark.parametrize("channels", range(1, 9))
@pytest.mark.parametrize("count", [0, 1, 5, 67])
def test_forward_and_backward_follow_the_definition(isa, channels, count):
    rng = np.random.default_rng(channels)
    points = rng.random((count, 3), np.float32)
    points[: count // 4] = rng.integers(0, 2, (count // 4, 3))  # the cube's own corners
    table = rng.standard_normal((637, channels)).astype(np.float32)
    out = np.full((count, 3 * channels), np.nan, np.float32)
    kernels.hash_forward(points, table, HASHED, out)
    # Positions of up to 31 cells are known to 31 * 2^-24, and the weights' error is as large.
    np.testing.assert_allclose(out, encode(points, table, HASHED), atol=3e-5)

    out_grad = rng.standard_normal(out.shape).astype(np.float32)
    grad = np.full_like(table, np.nan)
    kernels.hash_backward(points, out_grad, HASHED, grad)
    np.testing.assert_allclose(grad, table_gradient(points, out_grad, HASHED, table.shape), atol=1e-4)


@pytest.mark.parametrize("channels", [1, 8])
def test_many_points_are_encoded_as_few_are(isa, channels):
    """More than a block's 65,536, with rows that are kept level by level inside (24 numbers), and with short ones."""
    rng = np.random.default_rng(4)
    points, few = rng.random((140_001, 3), np.float32), slice(139_990, None)
    table = rng.standard_normal((637, channels)).astype(np.float32)
    out, last = np.empty((140_001, 3 * channels), np.float32), np.empty((11, 3 * channels), np.float32)
    kernels.hash_forward(points, table, HASHED, out, threads=2)
    kernels.hash_forward(points[few], table, HASHED, last)
    np.testing.assert_array_equal(out[few], last)

    out_grad, grad = np.zeros_like(out), np.full_like(table, np.nan)
    met = [0, 65_535, 65_536, 131_072, 140_000]
    out_grad[met] = rng.standard_normal((5, 3 * channels))
    kernels.hash_backward(points, out_grad, HASHED, grad, threads=2)
    np.testing.assert_allclose(grad, table_gradient(points[met], out_grad[met], HASHED, table.shape), atol=1e-5)


@pytest.mark.parametrize("channels", [4, 7])
def test_bits_do_not_depend_on_threads(isa, channels):
    rng = np.random.default_rng(3)
    points = rng.random((5000, 3), np.float32)
    table = rng.standard_normal((637, channels)).astype(np.float32)
    out_grad = rng.standard_normal((5000, 3 * channels)).astype(np.float32)
    outs, grads = [], []
    for threads in (1, 2, 3, 8):
        outs.append(np.empty_like(out_grad))
        kernels.hash_forward(points, table, HASHED, outs[-1], threads=threads)
        grads.append(np.zeros_like(table))
        kernels.hash_backward(points, out_grad, HASHED, grads[-1], threads=threads)
    assert all(np.array_equal(outs[0], other) for other in outs[1:])
    assert all(np.array_equal(grads[0], other) for other in grads[1:])


def test_points_outside_extrapolate_the_border_cell_and_nan_shows(isa):
    table = np.arange(8, dtype=np.float32)[:, None]  # one cell: x + 2 y + 4 z
    points = np.array([[1.5, 0.25, -1], [3e38, 0, 0], [np.nan, 0, 0]], np.float32)
    out = np.empty((3, 1), np.float32)
    kernels.hash_forward(points, table, [(1, 0, 8, True)], out)
    assert out[0, 0] == 1.5 + 0.5 - 4
    assert not np.isfinite(out[2, 0])


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ([(4, 0, 124, True)], "needs"),
        ([(4, 0, 100, False)], "power of two"),
        ([(4, 600, 64, False)], "ends at entry 664"),
        ([(4, 0, 128, False), (4, 64, 128, False)], "share"),
        ([(0, 0, 8, True)], "resolution"),
    ],
)
def test_levels_that_would_read_outside_are_refused(levels, message):
    points, table = np.zeros((1, 3), np.float32), np.zeros((637, 1), np.float32)
    with pytest.raises(ValueError, match=message):
        kernels.hash_forward(points, table, levels, np.empty((1, len(levels)), np.float32))


def test_rows_must_agree():
    with pytest.raises(ValueError, match="2 points but 3 rows"):
        kernels.hash_forward(
            np.zeros((2, 3), np.float32), np.zeros((8, 1), np.float32), [(1, 0, 8, True)], np.zeros((3, 1), np.float32)
        )


def test_an_unknown_path_is_refused():
    with pytest.raises(ValueError, match="no path 'sse9'"):
        kernels.set_isa("sse9")
