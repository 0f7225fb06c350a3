import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.reprojection import (
    correspondences,
    reproject_mask,
    sample_bilinear,
    sparse_depth,
    warp_image,
)
from inpaint3d.scene.synthetic import BALL_RADIUS, synthetic_scene

SCENE = synthetic_scene(views=4, width=64, height=48, points=200, arc_deg=50)


def wall_camera(x: float) -> Camera:
    """A camera beside the origin that looks along +z at a wall z = 2."""
    return Camera(50, 50, 20, 15, 40, 30, np.concatenate([np.eye(3), [[x], [0], [0]]], 1))


def test_a_wall_moves_by_focal_times_baseline_over_depth():
    wall = np.full((30, 40), 2.0)
    xy, seen = correspondences(wall_camera(0), wall, wall_camera(0.4), wall)
    expected = wall_camera(0).pixel_centres() - [50 * 0.4 / 2, 0]
    np.testing.assert_allclose(xy, expected, atol=1e-9)
    np.testing.assert_array_equal(seen, expected[..., 0] >= 0)


def test_a_mask_on_the_wall_moves_along():
    wall = np.full((30, 40), 2.0)
    mask = np.zeros((30, 40), bool)
    mask[5:9, 12:20] = True
    moved, seen = reproject_mask(mask, wall_camera(0.4), wall, wall_camera(0), wall)
    expected = np.zeros((30, 40), bool)
    expected[5:9, 22:30] = True
    np.testing.assert_array_equal(moved, expected)
    assert not seen[:, :10].any()
    assert seen[:, 10:].all()


def test_the_z_test_refuses_what_source_sees_something_else_in_front_of():
    wall = np.full((30, 40), 2.0)
    in_front = wall.copy()
    in_front[:, 20:] = 1.0
    _, seen = correspondences(wall_camera(0), wall, wall_camera(0.4), in_front)
    assert seen[:, 10:30].all()
    assert not seen[:, 30:].any()
    _, untested = correspondences(wall_camera(0), wall, wall_camera(0.4), None)
    assert untested[:, 10:].all()


def test_pixels_without_a_surface_are_not_seen():
    depth = np.full((30, 40), 2.0)
    depth[0, 0], depth[0, 1], depth[0, 2] = np.inf, 0.0, np.nan
    _, seen = correspondences(wall_camera(0), depth, wall_camera(0), depth)
    assert not seen[0, :3].any()
    assert seen.sum() == depth.size - 3


def test_a_room_seen_from_the_next_camera_is_the_room():
    warped, seen = warp_image(SCENE.images[1], SCENE.cameras[1], SCENE.depths[1], SCENE.cameras[2], SCENE.depths[2])
    assert seen.mean() > 0.5
    assert not warped[~seen].any()
    right = np.abs(warped - SCENE.images[2])[seen].mean()
    unmoved = np.abs(SCENE.images[1] - SCENE.images[2])[seen].mean()
    assert right < 0.2 * unmoved


def test_the_balls_mask_is_carried_onto_the_ball_and_nothing_else():
    mask, seen = reproject_mask(
        SCENE.object_masks[1], SCENE.cameras[1], SCENE.depths[1], SCENE.cameras[2], SCENE.depths[2]
    )
    on_ball = SCENE.object_masks[2]
    assert (mask & ~on_ball).sum() <= 0.01 * on_ball.sum()
    assert (on_ball & seen & ~mask).sum() <= 0.01 * on_ball.sum()
    # Half a ball shows; the part turned away from the first camera is not seen there.
    assert mask.sum() > 0.6 * on_ball.sum()
    assert pytest.approx(0.2) == BALL_RADIUS


def test_bilinear_is_exact_on_a_ramp_and_flat_beyond_the_border():
    y, x = np.mgrid[:5, :7] + 0.5
    ramp = np.stack([x, y], -1)
    inside = np.array([[0.5, 0.5], [3.2, 2.9], [6.5, 4.5]])
    np.testing.assert_allclose(sample_bilinear(ramp, inside), inside, atol=1e-6)
    np.testing.assert_allclose(sample_bilinear(ramp, [[-9.0, 99.0]]), [[0.5, 4.5]])


def test_sparse_depth_keeps_the_nearest_point():
    depth = sparse_depth(wall_camera(0), [[0, 0, 2.0], [0, 0, 1.0], [0, 0, -1.0], [9, 0, 1.0]])
    assert depth[15, 20] == 1.0
    assert np.isfinite(depth).sum() == 1
