import cv2
import numpy as np
import pycolmap
import pytest

from inpaint3d.scene.image_io import Image
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.pose_estimation.lens import convert
from inpaint3d.stages.pose_estimation.undistort import Undistorter


def lens(model: str, *params: float) -> pycolmap.Camera:
    return pycolmap.Camera(camera_id=1, model=model, width=120, height=90, params=list(params))


BARREL = lens("SIMPLE_RADIAL", 100.0, 61.0, 44.0, -0.15)
CUSHION = lens("SIMPLE_RADIAL", 100.0, 60.0, 45.0, 0.15)


def ramp() -> Image:
    """A captured picture whose colours are its own pixel coordinates over 120."""
    y, x = np.mgrid[:90, :120] + 0.5
    return (np.stack([x, y, x * 0], -1) / 120).astype(np.float32)


FISHEYES = [
    lens("OPENCV_FISHEYE", 60.0, 62.0, 61.0, 44.0, 0.03, -0.01, 0.002, -0.0005),
    lens("SIMPLE_RADIAL_FISHEYE", 60.0, 60.0, 45.0, 0.0),  # no parameter, and bent all the same
]


@pytest.mark.parametrize("camera", FISHEYES)
def test_fisheyes_are_straightened_as_opencv_does(camera):
    """cv2.fisheye has the same model (Kannala and Brandt, PAMI 2006), with pixels whole at their centres."""
    flat = Undistorter(camera, 120)
    captured = np.random.default_rng(0).uniform((5, 5), (115, 85), (200, 2))
    fx, fy = camera.focal_length_x, camera.focal_length_y
    matrix = np.array([[fx, 0, camera.principal_point_x - 0.5], [0, fy, camera.principal_point_y - 0.5], [0, 0, 1]])
    bends = np.zeros(4)
    bends[: len(camera.extra_params_idxs())] = np.array(camera.params)[list(camera.extra_params_idxs())]
    expected = cv2.fisheye.undistortPoints(captured[:, None] - 0.5, matrix, bends, P=matrix)[:, 0] + 0.5
    np.testing.assert_allclose(flat.pixels(captured), expected, atol=1e-3)
    assert np.abs(expected - captured).max() > 10


@pytest.mark.parametrize("camera", [BARREL, CUSHION, *FISHEYES])
@pytest.mark.parametrize("side", [120, 60])
def test_a_pixel_of_the_pinhole_shows_what_the_lens_bent_there(camera, side):
    flat = Undistorter(camera, side)
    captured = np.random.default_rng(0).uniform((25, 20), (95, 70), (50, 2))
    colour = sample_bilinear(flat.image(ramp()), flat.pixels(captured))[:, :2] * 120
    # Bilinear twice and area averages, on a ramp: a few hundredths of a pixel.
    np.testing.assert_allclose(colour, captured, atol=0.1)


def test_without_distortion_nothing_moves():
    flat = Undistorter(lens("PINHOLE", 100.0, 90.0, 60.0, 45.0), 480)
    np.testing.assert_array_equal(flat.image(ramp()), ramp())
    np.testing.assert_allclose(flat.pixels([[3.0, 4.0]]), [[3.0, 4.0]], atol=1e-9)
    assert flat.valid is None
    camera = flat.camera(np.eye(4))
    assert (camera.width, camera.fx, camera.fy, camera.cx) == (120, 100, 90, 60)


def test_a_lens_that_bends_inwards_leaves_corners_without_pixels():
    assert Undistorter(BARREL, 120).valid is None  # the pinhole crops what a barrel adds
    valid = Undistorter(CUSHION, 120).valid
    assert valid is not None
    assert not valid[0, 0]
    assert valid[45, 60]


@pytest.mark.parametrize("side", [120, 60])
def test_what_lies_beyond_a_masks_border_is_as_its_border(side):
    """A cushion's corners are seen from outside of the captured picture."""
    flat = Undistorter(CUSHION, side)
    assert flat.mask(np.ones((90, 120), bool)).all()
    left = flat.mask(np.arange(120)[None] < np.full((90, 1), 30))
    assert left[:, 0].all()
    assert not left[:, -1].any()
    top = flat.mask(np.arange(90)[:, None] < np.full((1, 120), 30))
    assert top[0].all()
    assert not top[-1].any()


def test_masks_follow_their_pictures():
    flat = Undistorter(BARREL, 60)
    mask = ramp()[..., 0] > 0.4
    grey = flat.image(np.repeat(mask[..., None], 3, 2).astype(np.float32))[..., 0]
    sure = np.abs(grey - 0.5) > 0.49
    np.testing.assert_array_equal(flat.mask(mask)[sure], grey[sure] > 0.5)


def test_changing_the_model_keeps_what_both_know():
    camera = lens("SIMPLE_RADIAL", 100.0, 61.0, 44.0, -0.15)
    convert(camera, "OPENCV")
    assert list(camera.params) == [100, 100, 61, 44, -0.15, 0, 0, 0]
    convert(camera, "SIMPLE_RADIAL")
    assert list(camera.params) == [100, 61, 44, -0.15]
    convert(camera, "PINHOLE")
    assert list(camera.params) == [100, 100, 61, 44]


@pytest.mark.parametrize("side", [120, 60])
def test_what_was_transparent_is_no_evidence(side):
    """Nor is a pixel that any of it is averaged into, nor what the lens leaves empty anyway."""
    opaque = np.ones((90, 120), bool)
    opaque[:, :31] = False
    straight = Undistorter(lens("PINHOLE", 100.0, 90.0, 60.0, 45.0), side)
    valid = straight.combine_valid(opaque)
    assert valid is not None
    edge = 31 if side == 120 else 16
    assert not valid[:, :edge].any()
    assert valid[:, edge:].all()
    bent = Undistorter(BARREL, side)
    both = bent.combine_valid(opaque)
    assert both is not None
    assert not both[:, 0].any()
    if bent.valid is not None:
        assert not (both & ~bent.valid).any()
    assert straight.combine_valid(np.ones((90, 120), bool)) is None


def test_a_picture_of_one_row_keeps_it():
    strip = pycolmap.Camera(camera_id=1, model="PINHOLE", width=400, height=1, params=[300.0, 300.0, 200.0, 0.5])
    flat = Undistorter(strip, 100)
    assert (flat.width, flat.height) == (100, 1)
