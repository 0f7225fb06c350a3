import numpy as np

from inpaint3d.scene.geometry import ray_sphere
from inpaint3d.scene.synthetic import BALL_RADIUS, ROOM_HIGH, ROOM_LOW, synthetic_scene

SCENE = synthetic_scene(views=5, width=40, height=30, points=150)


def test_the_world_is_normalised():
    centres = np.array([c.centre for c in SCENE.cameras])
    assert (np.linalg.norm(centres, axis=1) < 1).all()
    for camera in SCENE.cameras:
        xy, z = camera.project(np.zeros(3))
        assert camera.inside(xy, z)
        assert -camera.rotation[2, 1] > 0.5  # the picture's up is the world's +z


def test_depths_are_those_of_the_ball_and_the_walls():
    for camera, depth, mask in zip(SCENE.cameras, SCENE.depths, SCENE.object_masks, strict=True):
        points = camera.unproject(camera.pixel_centres(), depth)
        np.testing.assert_allclose(np.linalg.norm(points[mask], axis=-1), BALL_RADIUS, atol=1e-9)
        walls = np.minimum(np.abs(points - ROOM_LOW), np.abs(points - ROOM_HIGH)).min(-1)
        np.testing.assert_allclose(walls[~mask], 0, atol=1e-9)
        *_, hit = ray_sphere(*camera.rays(), np.zeros(3), BALL_RADIUS)
        np.testing.assert_array_equal(mask, hit)


def test_without_the_ball_the_rest_is_the_same():
    mask = SCENE.object_masks
    np.testing.assert_array_equal(SCENE.depths[~mask], SCENE.empty_depths[~mask])
    assert (SCENE.empty_depths[mask] > SCENE.depths[mask]).all()
    # Pixels on the ball's edge hold a share of it, though their centre misses it.
    grown = mask.copy()
    for axis in (1, 2):
        for shift in (-1, 1):
            grown |= np.roll(mask, shift, axis)
    np.testing.assert_array_equal(SCENE.images[~grown], SCENE.empty_images[~grown])
    assert np.abs(SCENE.images - SCENE.empty_images)[mask].mean() > 0.05


def test_tracks_are_exact_and_on_visible_surfaces():
    points = SCENE.points
    assert len(points) == 150
    assert (np.diff(points.track_offsets) >= 3).all()
    for frame, camera in enumerate(SCENE.cameras):
        rows = points.track_frame == frame
        index, xy = points.track_point[rows], points.track_xy[rows]
        projected, z = camera.project(points.xyz[index])
        np.testing.assert_allclose(projected, xy, atol=2e-3)  # float32 points, 40 px lens
        column, row = np.clip(xy.astype(int).T, 0, [[39], [29]])
        # Where the surface is smooth, a pixel's depth is its point's but for half a pixel of slope.
        assert np.median(np.abs(SCENE.depths[frame][row, column] - z) / z) < 0.02


def test_equal_arguments_give_equal_bytes_and_another_seed_another_texture():
    again = synthetic_scene(views=5, width=40, height=30, points=150)
    np.testing.assert_array_equal(again.images, SCENE.images)
    np.testing.assert_array_equal(again.points.track_xy, SCENE.points.track_xy)
    assert np.abs(synthetic_scene(views=5, width=40, height=30, seed=1).images - SCENE.images).mean() > 0.05


def test_pictures_are_textured():
    assert SCENE.images.dtype == np.float32
    assert 0 <= SCENE.images.min() < SCENE.images.max() <= 1
    assert SCENE.images.std(axis=(1, 2)).min() > 0.1
