"""Planes among points."""

import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.planes import Plane, fit_planes

TOLERANCE = 0.01


def points_on(normal: np.ndarray, offset: float, count: int, rng: np.random.Generator) -> np.ndarray:
    across = np.linalg.svd(normal[None])[2][1:]
    return offset * normal + rng.uniform(-1, 1, (count, 2)) @ across + rng.normal(0, 0.2 * TOLERANCE, (count, 3))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def test_planes_are_found_among_clutter(rng: np.random.Generator) -> None:
    """Two planes, of many and of few points, in any direction; and no third one."""
    wanted = [(np.array([0.6, 0.0, 0.8]), 0.3, 600), (np.array([0.0, 1.0, 0.0]), -0.5, 200)]
    points = np.concatenate([points_on(*plane, rng) for plane in wanted] + [rng.uniform(-1, 1, (500, 3))])
    found = fit_planes(rng.permutation(points), TOLERANCE)
    assert len(found) == 2
    for plane, (normal, offset, _) in zip(found, wanted, strict=True):
        sign = np.sign(plane.normal @ normal)
        np.testing.assert_allclose(sign * plane.normal, normal, atol=5e-3)
        assert sign * plane.offset == pytest.approx(offset, abs=2e-3)


def test_a_plane_among_much_else_is_not_askew(rng: np.random.Generator) -> None:
    """One point in five is on it, so that few triples are: none of them leans as little as all of its points do."""
    plane = np.c_[rng.uniform(-0.5, 0.5, (1000, 2)), rng.normal(0, TOLERANCE / 2, 1000)]
    for _ in range(5):
        found = fit_planes(rng.permutation(np.concatenate([plane, rng.uniform(-1, 1, (4000, 3))])), TOLERANCE)
        tilt = np.degrees(np.arccos(abs(found[0].normal[2])))
        assert tilt < 0.1


def test_clutter_holds_no_plane(rng: np.random.Generator) -> None:
    """A slab of a crowd of points has many points, and is no surface."""
    assert fit_planes(rng.uniform(-1, 1, (20_000, 3)), TOLERANCE) == []


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((200, 3)), np.linspace(0, 1, 200)[:, None] * np.ones(3)])
def test_too_few_points_one_point_and_a_line_hold_no_plane(points: np.ndarray, rng: np.random.Generator) -> None:
    assert fit_planes(points, TOLERANCE) == []
    assert fit_planes(points + rng.normal(0, 0.5 * TOLERANCE, points.shape), TOLERANCE) == []


def test_the_same_points_give_the_same_planes(rng: np.random.Generator) -> None:
    points = np.concatenate([points_on(np.array([0.0, 0.0, 1.0]), 0.1, 300, rng), rng.uniform(-1, 1, (300, 3))])
    (one,), (two,) = fit_planes(points, TOLERANCE), fit_planes(points.copy(), TOLERANCE)
    np.testing.assert_array_equal(one.normal, two.normal)


def test_a_plane_is_seen_before_the_camera_and_nowhere_along_it() -> None:
    camera = Camera(10, 10, 8, 8, 16, 16, look_at((0, 0, 0), (0, 1, 0)))
    floor = Plane(np.array([0.0, 0.0, 1.0]), -2.0)
    # 4 px below the middle a ray falls by 0.4 a unit; the middle one is parallel to the floor, and those above rise.
    pixels = np.array([[8.0, 12.0], [8.0, 8.0], [8.0, 4.0]])
    assert floor.depth(camera, pixels).tolist() == [pytest.approx(5.0), np.inf, np.inf]
