import numpy as np
import pytest

from inpaint3d import kernels


def test_a_wall_takes_all_the_light_and_its_neighbours_half_of_the_samples(isa):
    side = 8
    density = np.zeros((side, side, side), np.float32)
    density[:, :, 5] = 1e6  # x in [0.25, 0.5) of a cube of half side 1
    origins, directions = np.array([[-0.95, 0.1, 0.1]], np.float32), np.array([[1, 0, 0]], np.float32)
    tdist = np.linspace(0, 1.9, 20).astype(np.float32)
    out = np.full((1, 19), np.nan, np.float32)
    kernels.grid_histogram(
        kernels.Cells(density.ravel(), side, 1.0), kernels.Rays(origins, directions, tdist), 0.25, out
    )
    (wall,) = np.flatnonzero(out[0] > 1)
    assert -0.95 + (tdist[wall] + tdist[wall + 1]) / 2 == pytest.approx(0.3, abs=0.05)
    np.testing.assert_allclose(out[0, [wall - 1, wall, wall + 1]], [0.75, 1.25, 0.75], atol=1e-6)
    assert (np.delete(out[0], [wall - 1, wall, wall + 1]) == np.float32(0.25)).all()


def test_cells_are_lessened_once_and_raised_to_the_largest(isa):
    density = np.arange(8, dtype=np.float32)
    cube = np.array([[0.9, 0.9, 0.9], [0.9, 0.8, 0.7], [0.9, 0.1, 0.1], [np.nan, -5, 0.2]], np.float32)
    kernels.grid_learn(density, 2, cube, np.array([1, 6, 0, 3], np.float32), 0.5)
    assert density.tolist() == [3, 0.5, 2, 3, 4, 5, 6, 6]


def test_arrays_must_fit():
    density, points = np.zeros(8, np.float32), np.zeros((3, 3), np.float32)
    with pytest.raises(ValueError, match="3 cells a side does not hold 8"):
        kernels.grid_learn(density, 3, points, np.zeros(3, np.float32), 0.5)
    with pytest.raises(ValueError, match="seen has the wrong shape"):
        kernels.grid_learn(density, 2, points, np.zeros(2, np.float32), 0.5)
    with pytest.raises(ValueError, match="at least one interval"):
        kernels.grid_histogram(
            kernels.Cells(density, 2, None),
            kernels.Rays(points, points, np.zeros(1, np.float32)),
            0.0,
            np.zeros((3, 0), np.float32),
        )
