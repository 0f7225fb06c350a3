"""Depth that keeps to planes."""

import numpy as np
import pytest

from inpaint3d.scene.planes import Plane
from inpaint3d.scene.synthetic import arc_cameras
from inpaint3d.stages.view_completion.surfaces import Relief, snap_to_planes

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
    made = snap_to_planes(soft, camera, [Relief(plane, np.zeros((0, 3)))], 0.05)
    np.testing.assert_allclose(made[:, 10:], true[:, 10:], rtol=1e-5)
    np.testing.assert_array_equal(made[:, :10], soft[:, :10].astype(np.float32))
    np.testing.assert_array_equal(snap_to_planes(soft, camera, [], 0.05), soft.astype(np.float32))
    reach = np.where(np.arange(40) < 20, 0.0, 0.05)[None].repeat(30, 0)
    some = snap_to_planes(soft, camera, [Relief(plane, np.zeros((0, 3)))], reach)
    np.testing.assert_array_equal(some[:, :20], soft[:, :20].astype(np.float32))
    np.testing.assert_allclose(some[:, 20:], true[:, 20:], rtol=1e-5)


def test_a_plane_that_is_not_in_view_is_at_no_depth() -> None:
    camera = arc_cameras(3, 40, 30)[0]
    ahead = camera.unproject(np.array([[20.0, 15.0]]), np.ones(1))[0] - camera.centre
    behind = Plane(ahead, float(ahead @ (camera.centre - ahead)))
    depth = behind.depth(camera, np.array([[20.0, 15.0]]))
    assert np.isinf(depth).all()


def test_depth_keeps_to_what_lies_on_a_plane(rng: np.random.Generator) -> None:
    """A carpet on a floor, less high than the plane's tolerance; no point is known in the middle, nor is any exact."""
    camera = arc_cameras(3, 40, 30)[0]
    pixels = camera.pixel_centres().reshape(-1, 2)
    floor = Plane(camera.centre / np.linalg.norm(camera.centre), 0.0)
    on_floor = rng.uniform(-1, 1, (3000, 2)) @ np.linalg.svd(floor.normal[None])[2][1:]
    out = np.linalg.norm(on_floor, axis=-1)
    height = 0.5 * TOLERANCE * (out < 0.6) + 0.2 * TOLERANCE * rng.standard_normal(len(out))
    relief = Relief(floor, (on_floor + height[:, None] * floor.normal)[out > 0.2])
    soft = floor.depth(camera, pixels).reshape(30, 40) * (1 + 1e-3 * rng.standard_normal((30, 40)))
    made = snap_to_planes(soft, camera, [relief], 0.05).reshape(-1)
    points = camera.unproject(pixels, made)
    out = np.linalg.norm(points, axis=-1)
    middle, border = out < 0.2, (out > 0.8) & (out < 0.9)
    np.testing.assert_allclose(floor.height(points)[middle], 0.5 * TOLERANCE, atol=0.15 * TOLERANCE)
    np.testing.assert_allclose(floor.height(points)[border], 0.0, atol=0.15 * TOLERANCE)
