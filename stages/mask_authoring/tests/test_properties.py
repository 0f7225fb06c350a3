"""What masks keep, whatever the volume, the mask and the resolution."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from inpaint3d.scene.geometry import ray_sphere
from inpaint3d.scene.synthetic import arc_cameras
from inpaint3d.scene.volumes import box, sphere, volume_mask
from inpaint3d.stages.mask_authoring.cloud import splat
from inpaint3d.stages.mask_authoring.finish import finish
from inpaint3d.stages.mask_authoring.hull import carve
from inpaint3d.stages.mask_authoring.segment import iou
from inpaint3d.stages.mask_authoring.views import DepthView
from tests.mask_bench import FAST, Bench, make_bench, middle_of_ball

quick = settings(max_examples=20, derandomize=True, deadline=None, database=None)
CAMERAS = arc_cameras(6, 80, 60, arc_deg=150)
OFFSET = st.floats(-0.15, 0.15)
MASKS = hnp.arrays(bool, (30, 40))
SHARES = st.floats(0, 0.2)


def show_ball(centre: tuple[float, float, float], radius: float) -> list[DepthView]:
    """Views of a ball before a far wall, with its exact depth."""
    views = []
    for i, camera in enumerate(CAMERAS):
        origins, directions = camera.rays()
        near, _, hit = ray_sphere(origins, directions, centre, radius)
        along = directions @ camera.forward
        depth = np.where(hit, np.where(hit, near, 0.0) * along, 5.0)
        views.append(DepthView(f"view_{i}", camera, depth, lambda: np.zeros((60, 80, 3), np.float32)))
    return views


@quick
@given(OFFSET, OFFSET, OFFSET, st.floats(0.08, 0.25))
def test_a_volume_projected_into_views_and_carved_from_them_is_all_there(x, y, z, radius):
    """A visual hull holds the volume: every voxel whose centre is in the ball stays."""
    views, ball = show_ball((x, y, z), radius), sphere((x, y, z), radius)
    masks = [volume_mask(view.camera, ball) for view in views]
    hull = carve(views, masks, voxels=24, agreement=0.9, tolerance=0.05)
    side = float(hull.sizes[0])
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    # The voxel that holds a point this deep in the ball has its centre in the ball, and in its pixel of every mask.
    inner = (x, y, z) + directions * (radius - 2 * side) * rng.random((200, 1)) ** (1 / 3)
    off = np.abs(inner[:, None] - hull.points).max(-1).min(1)
    assert (off <= side / 2 + 1e-9).all()


@quick
@given(OFFSET, OFFSET, OFFSET, st.floats(0.08, 0.25))
def test_the_hull_shown_again_covers_the_volumes_masks(x, y, z, radius):
    views, ball = show_ball((x, y, z), radius), sphere((x, y, z), radius)
    masks = [volume_mask(view.camera, ball) for view in views]
    hull = carve(views, masks, voxels=48, agreement=0.9, tolerance=0.05)
    for view, mask in zip(views, masks, strict=True):
        smaller = volume_mask(view.camera, sphere((x, y, z), radius - 1.5 * float(hull.sizes[0])))
        assert not (smaller & ~splat(view, hull, 0.05)).any()
        assert not (splat(view, hull, 0.05) & ~mask).sum() > 0.3 * mask.sum()


@quick
@given(MASKS, SHARES, SHARES)
def test_more_dilation_never_takes_a_pixel_away(mask, one, other):
    less, more = sorted((one, other))
    assert not (mask & ~finish(mask, less)).any()
    assert not (finish(mask, less) & ~finish(mask, more)).any()


@quick
@given(OFFSET, OFFSET, OFFSET, st.floats(0.05, 3.0), st.floats(-180, 180))
def test_an_inverted_volume_is_the_complement_in_every_view(x, y, z, size, yaw):
    """Rays that start inside count: the larger volumes hold the cameras."""
    for camera in CAMERAS:
        for make in (
            lambda **how: sphere((x, y, z), size, **how),
            lambda **how: box((x, y, z), (size, 2 * size, size), yaw, **how),
        ):
            plain, inverted = volume_mask(camera, make()), volume_mask(camera, make(inverted=True))
            np.testing.assert_array_equal(inverted, ~plain)


@pytest.fixture(scope="module")
def benches(tmp_path_factory) -> list[Bench]:
    return [make_bench(tmp_path_factory.mktemp("store"), width=w, height=3 * w // 4) for w in (160, 320)]


def test_twice_the_resolution_finds_the_same(benches):
    scores = []
    for bench in benches:
        request = {"kind": "object", "view": "view_002", "points": [middle_of_ball(bench.scene, 2)]}
        masks = bench.masks(request, config=FAST)
        scores.append(np.mean([iou(m, t) for m, t in zip(masks, bench.scene.object_masks, strict=True)]))
    assert scores[0] > 0.9
    assert abs(scores[1] - scores[0]) < 0.01
