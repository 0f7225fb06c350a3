"""Splats as arrays: their axes, and those to begin with."""

import numpy as np
import pytest

from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.synthetic import ROOM_HIGH, ROOM_LOW, synthetic_scene
from inpaint3d.stages.splat_export.cloud import Y_DOWN, Y_UP, Z_UP, SplatCloud
from inpaint3d.stages.splat_export.start import begin, lie_across, thin_out


def matrices(quaternion):
    w, x, y, z = np.asarray(quaternion, np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def by_chance(count, seed=0):
    rng = np.random.default_rng(seed)
    parts = rng.normal(size=(count, 3)), rng.normal(-4, 1, (count, 3)), 5 * rng.normal(size=(count, 4))
    cloud = SplatCloud(*parts, rng.normal(size=count) * 3, rng.random((count, 3)))
    return cloud.map(lambda array: array.astype(np.float32))


@pytest.mark.parametrize(
    ("axes", "matrix"),
    [
        (Z_UP, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        (Y_DOWN, [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        (Y_UP, [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
    ],
)
def test_turning_moves_places_and_covariances_alike(axes, matrix):
    cloud, matrix = by_chance(50), np.array(matrix, np.float64)
    turned = cloud.turn(axes)
    np.testing.assert_allclose(turned.mean, cloud.mean @ matrix.T, atol=1e-6)
    np.testing.assert_allclose(matrices(turned.quaternion), matrix @ matrices(cloud.quaternion), atol=1e-6)


def test_quaternions_have_unit_length_and_no_negative_w():
    quaternion = by_chance(100).quaternion
    np.testing.assert_allclose(np.linalg.norm(quaternion, axis=1), 1, atol=1e-6)
    assert (quaternion[:, 0] >= 0).all()


def test_a_splat_lies_across_its_normal():
    rng = np.random.default_rng(1)
    normal = rng.normal(size=(100, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[0], normal[1], normal[2] = (0, 0, -1), (0, 0, 1), (0, 0, 0)
    turned = matrices(lie_across(normal))[:, :, 2]
    np.testing.assert_allclose(turned[[0, 1, *range(3, 100)]], normal[[0, 1, *range(3, 100)]], atol=1e-6)
    np.testing.assert_allclose(turned[2], (0, 0, 1))


def test_the_finest_place_of_a_cell_is_kept_and_empties_the_coarser_ones_around():
    place = np.array([[0.1, 0.1, 0.1], [0.11, 0.1, 0.1], [0.4, 0.1, 0.1], [0.9, 0.1, 0.1], [1.9, 0.1, 0.1]])
    size = np.array([0.25, 0.25, 0.25, 1.0, 1.0])
    # The second shares a cell with the first, the fourth a cell of its own size with the first and third.
    assert thin_out(place, size).tolist() == [True, False, True, False, True]


@pytest.mark.parametrize("most", [8, 100, 800])
def test_they_begin_on_the_rooms_walls_in_their_colours(most):
    scene = synthetic_scene(views=4)
    seen = zip(scene.cameras, scene.empty_images, scene.empty_depths, strict=True)
    views = [SurfaceView(camera, image, depth.astype(np.float32)) for camera, image, depth in seen]
    cloud = begin(views, list(scene.empty_images), most)
    assert 0.3 * most <= len(cloud) <= most
    away = np.minimum(np.abs(cloud.mean - ROOM_LOW), np.abs(cloud.mean - ROOM_HIGH)).min(1)
    assert away.max() < 1e-5
    assert cloud.rgb.min() >= 0
    assert cloud.rgb.max() <= 1
    assert np.isfinite(cloud.log_scale).all()
