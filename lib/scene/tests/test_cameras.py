import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inpaint3d.contracts.models.artifacts import PosedFrame
from inpaint3d.scene.cameras import Camera, as_pose, look_at

CAMERA = Camera(100.0, 120.0, 32.0, 20.0, 64, 48, look_at((1.0, -2.0, 0.5), (0.0, 0.1, 0.2)))


def test_a_camera_at_the_origin_follows_opencvs_axes():
    camera = Camera(100, 100, 50, 40, 100, 80, np.eye(4))
    xy, z = camera.project([[0.1, 0.2, 1.0], [0, 0, 2.0]])
    np.testing.assert_allclose(xy, [[60, 60], [50, 40]])  # +x is right, +y is down
    np.testing.assert_allclose(z, [1, 2])


def test_the_first_pixels_centre_is_at_a_half():
    np.testing.assert_array_equal(CAMERA.pixel_centres()[0, :2], [[0.5, 0.5], [1.5, 0.5]])
    assert CAMERA.pixel_centres().shape == (48, 64, 2)


@given(st.floats(-50, 120), st.floats(-50, 120), st.floats(1e-3, 1e4))
def test_unproject_is_the_inverse_of_project(x, y, z):
    xy, depth = CAMERA.project(CAMERA.unproject([[x, y]], [z]))
    # 1e-12 of a ray's length, seen through a lens of 100 px, next to the camera's distance from the origin.
    np.testing.assert_allclose(xy, [[x, y]], atol=1e-9 * (1 + 1 / z))
    np.testing.assert_allclose(depth, [z], rtol=1e-9, atol=1e-12)


def test_rays_are_unit_and_meet_what_projects_there():
    origins, directions = CAMERA.rays()
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, rtol=1e-12)
    xy, z = CAMERA.project(origins + 3 * directions)
    np.testing.assert_allclose(xy, CAMERA.pixel_centres(), atol=1e-9)
    np.testing.assert_allclose(z, 3 * (directions @ CAMERA.forward), rtol=1e-9)


def test_scaling_moves_projections_with_the_picture():
    points = CAMERA.unproject([[10.0, 5.0], [60.0, 40.0]], [1.0, 2.0])
    small, _ = CAMERA.resize_to(32, 12).project(points)
    np.testing.assert_allclose(small, [[5.0, 1.25], [30.0, 10.0]])


def test_points_behind_or_on_the_cameras_plane_are_outside():
    camera = Camera(100, 100, 50, 40, 100, 80, np.eye(4))
    xy, z = camera.project([[0, 0, 1.0], [0, 0, -1.0], [0, 0, 0.0], [0.6, 0, 1.0]])
    np.testing.assert_array_equal(camera.inside(xy, z), [True, False, False, False])


def test_look_at_puts_the_target_in_the_middle_and_up_upwards():
    xy, z = CAMERA.project([[0.0, 0.1, 0.2], [0.0, 0.1, 0.3]])
    np.testing.assert_allclose(xy[0], [32, 20], atol=1e-9)
    assert xy[1, 1] < xy[0, 1]
    assert z[0] == pytest.approx(np.linalg.norm(CAMERA.centre - [0, 0.1, 0.2]))
    np.testing.assert_allclose(CAMERA.rotation.T @ CAMERA.rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(CAMERA.rotation) == pytest.approx(1)
    with pytest.raises(ValueError, match="line of sight"):
        look_at((0, 0, 0), (0, 0, 1))


def test_cam_from_world_undoes_world_from_cam():
    both = np.vstack([CAMERA.world_from_cam, [0, 0, 0, 1]]) @ np.vstack([CAMERA.cam_from_world, [0, 0, 0, 1]])
    np.testing.assert_allclose(both, np.eye(4), atol=1e-12)


def test_a_camera_survives_the_contracts_model():
    frame = PosedFrame(
        name="a", path="frames/a.png", width=64, height=48, fx=100, fy=120, cx=32, cy=20, world_from_cam=CAMERA.pose
    )
    back = Camera.from_model(frame)
    np.testing.assert_array_equal(back.world_from_cam, CAMERA.world_from_cam)
    np.testing.assert_array_equal(back.intrinsics, CAMERA.intrinsics)


def test_a_pose_of_another_shape_is_refused():
    with pytest.raises(ValueError, match=r"\(2, 2\)"):
        Camera(1, 1, 1, 1, 2, 2, np.eye(2))
    assert as_pose(np.eye(4)) == ((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0))
