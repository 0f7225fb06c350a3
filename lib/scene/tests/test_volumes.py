import numpy as np
import pytest
from scipy.spatial import ConvexHull

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
    assert volume_mask(camera(), box((0, -2, 0), (1, 1, 1), 20)).all()
    assert not volume_mask(camera(), box((0, -4, 0), (1, 1, 1), 20)).any()


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


def random_cameras(count: int) -> list[Camera]:
    rng = np.random.default_rng(0)
    places = rng.normal(size=(count, 3)) * (1.5, 1.5, 0.8)
    return [camera(place, rng.normal(size=3) * 0.3, size=120, focal=110.0) for place in places]


@pytest.mark.parametrize("index", range(12))
def test_a_sphere_is_the_inside_of_its_outlines_conic_to_a_pixel(index):
    """The dual of the outline's conic is P Q* P' (Hartley and Zisserman, Multiple View Geometry, eq. 8.6)."""
    rng = np.random.default_rng(index)
    centre, radius = rng.normal(size=3) * 0.4, rng.uniform(0.1, 0.6)
    own = random_cameras(12)[index]
    mask = volume_mask(own, sphere(centre, radius))
    if np.linalg.norm(own.centre - centre) <= radius:
        assert mask.all(), "rays that start inside are in the hole"
        return
    move = np.eye(4)
    move[:3, 3] = centre
    dual = move @ np.diag([radius**2, radius**2, radius**2, -1]) @ move.T
    projection = own.intrinsics @ own.cam_from_world
    conic = np.linalg.inv(projection @ dual @ projection.T)
    middle = projection @ np.append(centre, 1.0)
    pixels = np.concatenate([own.pixel_centres(), np.ones((120, 120, 1))], -1)
    sign = np.sign(middle @ conic @ middle)
    inside = sign * np.einsum("hwi,ij,hwj->hw", pixels, conic, pixels) >= 0
    if middle[2] - radius > 0:  # all of it in front of the camera: the conic is an ellipse
        np.testing.assert_array_equal(mask, inside)


@pytest.mark.parametrize("index", range(12))
def test_a_box_is_the_hull_of_its_projected_corners_to_a_pixel(index):
    rng = np.random.default_rng(index)
    centre, size, yaw = rng.normal(size=3) * 0.4, rng.uniform(0.2, 1.0, 3), rng.uniform(-180, 180)
    own = random_cameras(12)[index]
    mask = volume_mask(own, box(centre, size, yaw))
    turn = rotation_about_z(yaw)
    if np.all(np.abs((own.centre - centre) @ turn) <= size / 2):
        assert mask.all(), "rays that start inside are in the hole"
        return
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners, z = own.project(centre + (signs * size / 2) @ turn.T)
    if z.min() > 0:
        hull = corners[ConvexHull(corners).vertices]
        edges = np.roll(hull, -1, 0) - hull
        offsets = own.pixel_centres()[:, :, None] - hull
        crosses = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
        np.testing.assert_array_equal(mask, (crosses >= 0).all(-1))
