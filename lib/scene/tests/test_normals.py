import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.geometry import ray_sphere
from inpaint3d.scene.normals import normals_of

CAMERA = Camera(60, 66, 23, 19, 48, 36, look_at((0.9, 0.2, 0.3), (0, 0, 0)))


def plane_depth(normal, offset: float) -> np.ndarray:
    """Depth along the axis at which the pixels' rays meet the plane normal . x = offset."""
    origins, directions = CAMERA.rays()
    distance = (offset - origins @ normal) / (directions @ normal)
    return distance * (directions @ CAMERA.forward)


def towards_camera(normal) -> np.ndarray:
    return normal if normal @ CAMERA.forward < 0 else -normal


@pytest.mark.parametrize("tilt", [(1.0, 0.0, 0.0), (0.8, 0.3, -0.4), (-0.9, 0.2, -0.1)])
def test_a_plane_has_its_own_normal_at_every_pixel(tilt) -> None:
    normal = np.array(tilt) / np.linalg.norm(tilt)
    found = normals_of(CAMERA, plane_depth(normal, -2.0 * np.sign(normal[0])))
    assert found.shape == (36, 48, 3)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, np.broadcast_to(towards_camera(normal), found.shape), atol=1e-5)


def test_a_ball_has_its_radii() -> None:
    origins, directions = CAMERA.rays()
    near, _, _ = ray_sphere(origins, directions, np.zeros(3), 0.3)
    depth = np.where(np.isfinite(near), near, np.nan) * (directions @ CAMERA.forward)
    inner, _, _ = ray_sphere(origins, directions, np.zeros(3), 0.25)
    core = np.isfinite(inner)
    radii = (origins + near[..., None] * directions)[core] / 0.3
    # One pixel is 1.2 degrees of the ball's middle and three of what is seen at 56 degrees.
    cosine = (normals_of(CAMERA, depth)[core] * radii).sum(-1)
    assert core.sum() > 200
    assert cosine.min() > np.cos(np.radians(4))


def test_an_edge_bends_nothing() -> None:
    """A wall before another: each pixel keeps to its own."""
    normal = np.array([0.8, 0.3, -0.4]) / np.linalg.norm([0.8, 0.3, -0.4])
    depth = np.where(np.arange(48) < 20, plane_depth(normal, 0.0), plane_depth(normal, -3.0))
    depth[17:] = plane_depth(normal, -6.0)[17:]
    expected = np.broadcast_to(towards_camera(normal), (36, 48, 3))
    np.testing.assert_allclose(normals_of(CAMERA, depth), expected, atol=1e-5)


def test_where_there_is_no_depth_there_is_no_normal() -> None:
    depth = plane_depth(np.array([1.0, 0.0, 0.0]), -2.0)
    depth[10:20, 10:20] = np.inf
    depth[30, 30] = np.nan
    found = normals_of(CAMERA, depth)
    assert np.isfinite(found).all()
    length = np.linalg.norm(found, axis=-1)
    assert (length[~np.isfinite(depth)] == 0).all()
    np.testing.assert_allclose(length[np.isfinite(depth)], 1, atol=1e-6)


@pytest.mark.parametrize("shape", [(1, 5), (5, 1), (1, 1)])
def test_a_row_of_pixels_has_none(shape) -> None:
    camera = Camera(60, 60, 2, 2, shape[1], shape[0], CAMERA.world_from_cam)
    assert not normals_of(camera, np.ones(shape)).any()
