import numpy as np
import pytest

from inpaint3d.scene.cameras import look_at
from inpaint3d.scene.geometry import Similarity, rotation_between
from inpaint3d.stages.pose_estimation.normalise import find_interest, find_up, median_depth, normalise

TARGET = np.array([0.2, -0.1, 0.3])


def ring(count=12, arc=200.0, height=1.0):
    angles = np.deg2rad(np.linspace(0, arc, count))
    return np.stack([look_at((2 * np.cos(a), 2 * np.sin(a), height), TARGET) for a in angles])


def test_any_similar_source_gives_the_same_world():
    poses, xyz = ring(), np.random.default_rng(0).normal(size=(40, 3))
    moved = Similarity(7.0, rotation_between((0, 0, 1), (1, -2, 0.5)), np.array([5.0, -3, 2]))
    a = normalise(poses, xyz, 0)
    b = normalise(np.stack([moved.pose(p) for p in poses]), moved.points(xyz), 0)
    for pose in poses:
        np.testing.assert_allclose(
            b.normalised_from_source.pose(moved.pose(pose)), a.normalised_from_source.pose(pose), atol=1e-6
        )
    assert a.centre_depth == pytest.approx(b.centre_depth, rel=1e-6)


def test_the_first_camera_is_at_minus_y_and_the_farthest_on_the_unit_ball():
    poses = ring()
    world = normalise(poses, np.zeros((0, 3)), 0)
    centres = world.normalised_from_source.points(poses[:, :, 3])
    assert centres[0, 0] == pytest.approx(0, abs=1e-9)
    assert centres[0, 1] < 0
    assert np.linalg.norm(centres, axis=1).max() == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(world.normalised_from_source.points(TARGET), 0, atol=1e-4)


def test_looking_down_does_not_tilt_up():
    # The mean of the cameras' own ups over a 90 degree arc leans by tens of degrees here.
    up, _ = find_up(ring(arc=90, height=2.5), np.zeros((0, 3)), 0)
    assert np.rad2deg(np.arccos(up[2])) < 2


def test_a_floor_near_level_corrects_up():
    rng = np.random.default_rng(1)
    floor = np.concatenate([rng.uniform(-2, 2, (300, 2)), rng.normal(0, 0.002, (300, 1)) - 0.5], 1)
    tilt = rotation_between((0, 0, 1), (0.1, 0.05, 1))
    poses = ring()
    poses[:, :, :3] = tilt @ poses[:, :, :3]  # a photographer who holds the camera askew
    up, evidence = find_up(poses, floor, 0)
    assert np.rad2deg(np.arccos(up[2])) < 0.3
    assert evidence.startswith("plane of ")


def test_parallel_cameras_look_at_the_middle_of_what_they_see():
    poses = np.stack([look_at((x, -3.0, 0.0), (x, 0.0, 0.0)) for x in np.linspace(-1, 1, 5)])
    xyz = np.random.default_rng(2).normal(0, 0.1, (50, 3))
    interest, reason = find_interest(poses, xyz)
    np.testing.assert_allclose(interest, [0, 0, 0], atol=0.05)
    assert "mean optical axis" in reason
    assert median_depth(poses, xyz) == pytest.approx(3, abs=0.05)
