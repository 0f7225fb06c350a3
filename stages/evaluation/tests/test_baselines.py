import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.evaluation.baselines import (
    interpolate_depth,
    mean_colour,
    mean_surround,
    nearest_photo_warped,
    ring_around,
)
from inpaint3d.stages.evaluation.photos import Photo


def photos(scene, known=None) -> list[Photo]:
    every = np.ones(scene.images[0].shape[:2], bool)
    return [
        Photo(name, "train", camera, image, ~every, every if known is None else known)
        for name, camera, image in zip(scene.names, scene.cameras, scene.images, strict=True)
    ]


def test_the_ring_is_a_square_neighbourhood_without_the_mask():
    mask = np.zeros((9, 11), bool)
    mask[4, 5] = True
    ring = ring_around(mask, 2)
    expected = np.zeros_like(mask)
    expected[2:7, 3:8] = True
    expected[4, 5] = False
    assert (ring == expected).all()


def test_the_ring_ends_at_the_border_and_does_not_wrap():
    mask = np.zeros((5, 6), bool)
    mask[0, 0] = True
    assert np.argwhere(ring_around(mask, 1)).tolist() == [[0, 1], [1, 0], [1, 1]]


def test_the_hole_takes_the_mean_of_its_ring_and_nothing_else_changes():
    rng = np.random.default_rng(0)
    image = rng.random((12, 14, 3), dtype=np.float32)
    mask = np.zeros((12, 14), bool)
    mask[5:8, 6:9] = True
    filled = mean_surround(image, mask, 2)
    np.testing.assert_allclose(filled[6, 7], image[ring_around(mask, 2)].mean(0), rtol=1e-6)
    assert (filled[~mask] == image[~mask]).all()
    image[mask] = 9.0  # what the hole held does not matter
    np.testing.assert_array_equal(mean_surround(image, mask, 2), filled)


def test_the_mean_colour_counts_known_pixels():
    scene = synthetic_scene(views=2)
    known = np.zeros(scene.images[0].shape[:2], bool)
    known[:4] = True
    expected = scene.images[:, :4].reshape(-1, 3).mean(0)
    np.testing.assert_allclose(mean_colour(photos(scene, known)), expected, rtol=1e-5)


def test_depth_of_points_on_a_plane_is_the_planes():
    camera = Camera(40, 40, 16, 12, 32, 24, look_at((0, -1.0, 0), (0, 0, 0)))
    xy = np.random.default_rng(0).uniform((0, 0), (32, 24), (3000, 2))
    depth = interpolate_depth(camera, camera.unproject(xy, np.full(len(xy), 0.7)))
    assert depth is not None
    np.testing.assert_allclose(depth, 0.7, rtol=1e-6)


def test_depth_between_points_is_near_the_true_one():
    scene = synthetic_scene(points=2000)
    depth = interpolate_depth(scene.cameras[3], scene.points.xyz)
    assert depth is not None
    assert np.median(np.abs(depth / scene.depths[3] - 1)) < 0.05


def test_a_camera_that_sees_no_point_has_no_depth():
    camera = Camera(40, 40, 16, 12, 32, 24, look_at((0, -1.0, 0), (0, 0, 0)))
    assert interpolate_depth(camera, np.array([[0.0, -5.0, 0.0]])) is None


def test_warping_with_the_true_depth_beats_the_unwarped_photo():
    scene = synthetic_scene(width=64, height=48)
    others = [p for i, p in enumerate(photos(scene)) if i != 3]
    warped = nearest_photo_warped(scene.cameras[3], scene.depths[3], others, (0.5, 0.5, 0.5))
    assert psnr(warped, scene.images[3]) > psnr(scene.images[2], scene.images[3]) + 3


def test_a_pixel_that_no_photo_knows_gets_the_fallback():
    scene = synthetic_scene(views=3)
    nothing = np.zeros(scene.images[0].shape[:2], bool)
    warped = nearest_photo_warped(scene.cameras[0], scene.depths[0], photos(scene, nothing), (0.1, 0.2, 0.3))
    assert warped == pytest.approx(np.broadcast_to((0.1, 0.2, 0.3), warped.shape))
