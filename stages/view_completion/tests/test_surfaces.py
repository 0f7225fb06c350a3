"""Depth that keeps to planes."""

import numpy as np
import pytest

from inpaint3d.scene.planes import Plane
from inpaint3d.scene.synthetic import arc_cameras
from inpaint3d.stages.view_completion.surfaces import snap_to_planes

TOLERANCE = 0.01


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_depth_near_a_plane_is_moved_onto_it_and_the_rest_is_left(rng: np.random.Generator) -> None:
    camera = arc_cameras(3, 40, 30)[0]
    pixels = camera.pixel_centres().reshape(-1, 2)
    towards = camera.centre / np.linalg.norm(camera.centre)
    plane = Plane(towards, 0.0)
    true = plane.depth(camera, pixels).reshape(30, 40)
    soft = true * (1 + 0.002 * rng.standard_normal(true.shape))
    soft[:, :10] = 0.5 * true[:, :10]
    made = snap_to_planes(soft, camera, [plane], 0.05)
    np.testing.assert_allclose(made[:, 10:], true[:, 10:], rtol=1e-5)
    np.testing.assert_array_equal(made[:, :10], soft[:, :10].astype(np.float32))
    np.testing.assert_array_equal(snap_to_planes(soft, camera, [], 0.05), soft.astype(np.float32))
    reach = np.where(np.arange(40) < 20, 0.0, 0.05)[None].repeat(30, 0)
    some = snap_to_planes(soft, camera, [plane], reach)
    np.testing.assert_array_equal(some[:, :20], soft[:, :20].astype(np.float32))
    np.testing.assert_allclose(some[:, 20:], true[:, 20:], rtol=1e-5)


def test_a_plane_that_is_not_in_view_is_at_no_depth() -> None:
    camera = arc_cameras(3, 40, 30)[0]
    ahead = camera.unproject(np.array([[20.0, 15.0]]), np.ones(1))[0] - camera.centre
    behind = Plane(ahead, float(ahead @ (camera.centre - ahead)))
    depth = behind.depth(camera, np.array([[20.0, 15.0]]))
    assert np.isinf(depth).all()
