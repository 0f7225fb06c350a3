import numpy as np
import pytest

from inpaint3d.scene.geometry import (
    Similarity,
    nearest_point_to_axes,
    ray_box,
    ray_sphere,
    rotation_about_z,
    rotation_between,
)


def test_a_ray_through_a_spheres_centre_runs_its_diameter():
    near, far, hit = ray_sphere([[0, 0, -5.0]], [[0, 0, 1.0]], (0, 0, 0), 2.0)
    assert (near[0], far[0], hit[0]) == (3.0, 7.0, True)


def test_a_ray_from_inside_starts_at_zero_and_one_away_from_it_misses():
    near, far, hit = ray_sphere([[0.0, 0, 0], [0, 0, 3.0]], [[0, 0, 1.0], [0, 0, 1.0]], (0, 0, 0), 2.0)
    np.testing.assert_array_equal(near, [0, np.inf])
    np.testing.assert_array_equal(far, [2, np.inf])
    np.testing.assert_array_equal(hit, [True, False])


@pytest.mark.parametrize("distance", [1e1, 1e3, 1e5, 1e7])
def test_a_small_sphere_far_away_keeps_its_size(distance):
    # half chord at an offset of 0.6 radii: 0.8 radii. b^2 - c instead loses it from 1e5 on.
    near, far, hit = ray_sphere([[0.6, 0, -distance]], [[0, 0, 1.0]], (0, 0, 0), 1.0)
    assert hit[0]
    assert far[0] - near[0] == pytest.approx(1.6, rel=1e-7)


def test_a_box_is_entered_and_left_at_its_faces():
    near, far, hit = ray_box([[0, -5.0, 0.1]], [[0, 1.0, 0]], (0, 1, 0), (2, 4, 1))
    assert (near[0], far[0], hit[0]) == (4.0, 8.0, True)


def test_a_turned_box_is_met_at_its_corner():
    near, far, _ = ray_box([[0, -5.0, 0]], [[0, 1.0, 0]], (0, 0, 0), (2, 2, 2), yaw_deg=45)
    assert near[0] == pytest.approx(5 - np.sqrt(2))
    assert far[0] == pytest.approx(5 + np.sqrt(2))


def test_a_ray_along_a_face_and_one_beside_it():
    origins = [[1.0, -5, 0], [1.001, -5, 0]]
    *_, hit = ray_box(origins, [[0, 1.0, 0], [0, 1.0, 0]], (0, 0, 0), (2, 2, 2))
    np.testing.assert_array_equal(hit, [True, False])


def inside_box(points: np.ndarray, centre: tuple, size: tuple, yaw_deg: float) -> np.ndarray:
    local = (points - np.asarray(centre)) @ rotation_about_z(-yaw_deg).T
    return np.all(np.abs(local) <= np.asarray(size) / 2, -1)


def test_rays_into_a_box_pass_through_points_inside_it():
    rng = np.random.default_rng(0)
    origins = rng.normal(size=(500, 3)) * 3
    directions = rng.normal(size=(500, 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    shape = ((0.3, -0.2, 0.1), (1.0, 2.0, 0.7), 30.0)
    near, far, hit = ray_box(origins, directions, *shape)
    middle = origins[hit] + ((near + far)[hit] / 2)[:, None] * directions[hit]
    assert inside_box(middle, *shape).all()
    steps = np.linspace(0, 20, 400)
    walked = origins[~hit][:, None] + steps[:, None] * directions[~hit][:, None]
    assert not inside_box(walked, *shape).any()
    assert 20 < hit.sum() < 480


def test_rotations():
    np.testing.assert_allclose(rotation_about_z(90) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    for a, b in (((1, 2, 3), (-2, 0.5, 1)), ((0, 0, 1), (0, 0, 1)), ((0, 0, 1), (0, 0, -1))):
        turn = rotation_between(a, b)
        np.testing.assert_allclose(turn @ a / np.linalg.norm(a), np.array(b) / np.linalg.norm(b), atol=1e-12)
        np.testing.assert_allclose(turn.T @ turn, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1)


def test_a_similarity_is_its_matrix_and_undone_by_its_inverse():
    rng = np.random.default_rng(1)
    given = Similarity(2.5, rotation_between((1, 0, 0), (1, 2, -1)), np.array([3.0, -1, 0.5]))
    source = rng.normal(size=(20, 3))
    np.testing.assert_allclose(given.points(source), source @ given.matrix[:, :3].T + given.matrix[:, 3], atol=1e-12)
    np.testing.assert_allclose(given.inverse().points(given.points(source)), source, atol=1e-12)


def test_a_moved_camera_sees_moved_points_where_it_saw_them():
    given = Similarity(0.3, rotation_between((0, 1, 0), (1, 1, 1)), np.array([1.0, 2, 3]))
    pose = np.concatenate([rotation_about_z(20), [[1.0], [2.0], [3.0]]], 1)
    point = np.array([0.3, -1.0, 2.0])
    before = pose[:, :3].T @ (point - pose[:, 3])
    moved = given.pose(pose)
    np.testing.assert_allclose(moved[:, :3].T @ (given.points(point) - moved[:, 3]), 0.3 * before, atol=1e-12)


def test_axes_through_one_point_meet_there_though_some_look_elsewhere():
    rng = np.random.default_rng(3)
    target = np.array([0.5, -0.2, 1.0])
    origins = rng.normal(size=(40, 3)) * 3
    directions = target - origins
    directions[:6] = rng.normal(size=(6, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # Reweighting leaves the strays a little pull: a plain mean of squares is off by 0.2 and more here.
    np.testing.assert_allclose(nearest_point_to_axes(origins, directions), target, atol=0.02)


def test_parallel_axes_have_a_finite_answer():
    origins = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]])
    point = nearest_point_to_axes(origins, np.tile([0, 0, 1.0], (3, 1)))
    np.testing.assert_allclose(point, [1, 0, 0], atol=1e-6)
