import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.geometry import rotation_about_z
from inpaint3d.scene.volumes import box, sphere, volume_mask


def camera(centre=(0.0, -2.0, 0.0), target=(0.0, 0.0, 0.0), size=201, focal=300.0):
    return Camera(focal, focal, size / 2, size / 2, size, size, look_at(centre, target))


def test_a_sphere_on_the_axis_is_a_disc_of_the_tangent_cones_radius():
    # tan of the tangent cone's half angle: r / sqrt(d^2 - r^2).
    mask = volume_mask(camera(), sphere((0, 0, 0), 0.5))
    radius = 300 * 0.5 / np.sqrt(2.0**2 - 0.5**2)
    y, x = np.mgrid[:201, :201] + 0.5 - 100.5
    distance = np.hypot(x, y)
    assert mask[distance < radius].all()
    assert not mask[distance > radius].any()


def test_a_box_seen_face_on_is_its_front_faces_rectangle():
    mask = volume_mask(camera(), box((0, 0, 0), (0.603, 1.0, 0.303)))
    # The front face is at y = -0.5, 1.5 from the camera, and hides the rest.
    y, x = np.abs(np.mgrid[:201, :201] + 0.5 - 100.5)
    expected = (x < 300 * 0.3015 / 1.5) & (y < 300 * 0.1515 / 1.5)
    np.testing.assert_array_equal(mask, expected)


def test_yaw_turns_the_box_counter_clockwise_seen_from_above():
    thin = box((0, 0, 0), (1.0, 0.02, 0.4), yaw_deg=30)
    on_it = 0.45 * np.array([np.cos(np.deg2rad(30)), np.sin(np.deg2rad(30)), 0])
    # Looking along the slab's plane it is nearly a line; across it, it is wide.
    along = volume_mask(camera(2 * on_it / 0.45), thin).sum()
    across = volume_mask(camera((np.sin(np.deg2rad(30)) * 2, -np.cos(np.deg2rad(30)) * 2, 0)), thin).sum()
    assert along < across / 5


@pytest.mark.parametrize("make", [sphere, lambda c, r, **k: box(c, (r, r, r), **k)])
def test_an_inverted_volume_is_the_complement(make):
    plain, inverted = make((0.2, 0.1, 0), 0.4), make((0.2, 0.1, 0), 0.4, inverted=True)
    np.testing.assert_array_equal(volume_mask(camera(), inverted), ~volume_mask(camera(), plain))


def test_a_volume_behind_the_camera_is_not_seen_and_one_round_it_fills_the_view():
    assert not volume_mask(camera(), sphere((0, -4, 0), 0.5)).any()
    assert volume_mask(camera(), sphere((0, -2, 0), 0.5)).all()


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_the_mask_does_not_depend_on_the_unit_of_length(scale):
    reference = volume_mask(camera(), sphere((0.1, 0, 0.1), 0.4))
    scaled = volume_mask(
        camera(centre=(0.0, -2.0 * scale, 0.0)), sphere(np.multiply(scale, (0.1, 0, 0.1)), 0.4 * scale)
    )
    np.testing.assert_array_equal(scaled, reference)


def test_points_inside_project_into_the_mask():
    volume = box((0.1, 0.2, -0.1), (0.5, 0.3, 0.4), yaw_deg=20)
    local = np.random.default_rng(1).uniform(-0.5, 0.5, (2000, 3)) * volume.size
    points = volume.centre + local @ rotation_about_z(20).T
    view = camera((0.3, -2, 0.5))
    xy, _ = view.project(points)
    column, row = xy.astype(int).T
    # A pixel's centre may just miss what one of its corners meets.
    assert volume_mask(view, volume)[row, column].mean() > 0.99
