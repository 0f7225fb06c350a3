"""The stage on the synthetic room, whose depth, cameras and object masks are exact."""

import cv2
import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError, ConfigurationError, WaitingError
from inpaint3d.scene.image_io import read_mask, write_mask
from inpaint3d.scene.map_io import write_exr
from inpaint3d.scene.synthetic import BALL_RADIUS, arc_cameras, synthetic_scene
from inpaint3d.scene.volumes import sphere, volume_mask
from inpaint3d.stages.mask_authoring.objects import check_room_around
from inpaint3d.stages.mask_authoring.views import read_depth
from tests.mask_bench import FAST, Bench, capture, field, make_bench, middle_of_ball, precision, put_truth, recall


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("store"))


def test_object_pointed_at_once_is_covered_in_every_view(bench):
    # Points on one view, depth off by 2 % in bumps, views up to 160 degrees apart, every surface of one texture.
    request = {"kind": "object", "view": "view_002", "points": [middle_of_ball(bench.scene, 2)]}
    masks = bench.masks(request, dilate=0.015)
    assert recall(masks, bench.scene.object_masks).min() > 0.98
    assert precision(masks, bench.scene.object_masks).min() > 0.7


def test_refinement_finds_what_the_source_view_cannot_see(bench):
    request = {"kind": "object", "view": "view_000", "points": [middle_of_ball(bench.scene, 0)]}
    far = slice(6, 8)  # views 110 degrees and more away
    plain = bench.masks(request, config=FAST.model_copy(update={"refine": False}))
    refined = bench.masks(request)
    truth = bench.scene.object_masks[far]
    assert recall(plain[far], truth).max() < 0.75
    assert recall(refined[far], truth).min() > 0.95


def test_a_room_without_shadows_gives_the_same_masks_when_shadows_are_asked_for(bench):
    request = {"kind": "object", "view": "view_002", "points": [middle_of_ball(bench.scene, 2)]}
    plain, asked = (bench.author(request, shadows=wanted) for wanted in (False, True))
    assert plain[0].shadows is None
    assert asked[0].shadows is not None
    assert not any(shadow.found for shadow in asked[0].shadows)
    assert asked[0].views == plain[0].views
    for view in plain[0].views:
        np.testing.assert_array_equal(read_mask(asked[1] / view.mask), read_mask(plain[1] / view.mask))


def test_pixels_may_be_read_on_a_picture_of_another_size(bench):
    x, y = middle_of_ball(bench.scene, 2)
    small = bench.masks({"kind": "object", "view": "view_002", "points": [[x, y]]})
    large = {"kind": "object", "view": "view_002", "points": [[5 * x, 5 * y]], "frame_size": [800, 600]}
    assert recall(small, bench.scene.object_masks).min() > 0.5, "empty masks would be equal too"
    for a, b in zip(small, bench.masks(large), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_box_on_one_view_works_like_points(bench):
    rows, columns = np.nonzero(bench.scene.object_masks[2])
    around = [columns.min() - 3, rows.min() - 3, columns.max() + 3, rows.max() + 3]
    masks = bench.masks({"kind": "object", "view": "view_002", "box": [float(v) for v in around]}, dilate=0.015)
    assert recall(masks, bench.scene.object_masks).min() > 0.98
    assert precision(masks, bench.scene.object_masks).min() > 0.7


def test_sphere_masks_are_the_sphere_in_views_and_truth_cameras_alike(bench):
    cameras = arc_cameras(3, 100, 80, arc_deg=50)
    truth = put_truth(bench.store, cameras)
    request = {"kind": "sphere", "centre": [0, 0, 0], "radius": BALL_RADIUS}
    metadata, root = bench.author(request, **{"posed-truth": truth})
    for view, expected in zip(metadata.views, bench.scene.object_masks, strict=True):
        np.testing.assert_array_equal(read_mask(root / view.mask), expected)
    for view, camera in zip(metadata.truth_views, cameras, strict=True):
        exact = volume_mask(camera, sphere((0, 0, 0), BALL_RADIUS))
        np.testing.assert_array_equal(read_mask(root / view.mask), exact)
    assert metadata.kind == "volume"
    assert metadata.consistency is None


def test_sphere_on_the_axis_lies_at_the_median_depth_of_the_middle_view(bench):
    exact = {"radiance-field": field(bench.store, bench.scene)}
    metadata, _ = bench.author({"kind": "sphere", "distance": 0.8, "radius": 0.3}, **exact)
    camera, median = bench.scene.cameras[4], np.median(bench.scene.depths[4])
    (volume,) = metadata.primitives
    expected = camera.centre + 0.8 * median * camera.forward
    # The field's maps have every second pixel: their median is nearly the whole picture's.
    np.testing.assert_allclose(volume.centre, expected, atol=0.01 * median)
    assert volume.size[0] == pytest.approx(2 * 0.3 * median, rel=0.01)


def test_outpainting_keeps_only_what_is_seen_through_the_sphere(bench):
    metadata, root = bench.author({"kind": "outpaint", "radius": 0.3})
    inverted = metadata.primitives[0]
    assert metadata.task == "outpaint"
    for view, camera in zip(metadata.views, bench.scene.cameras, strict=True):
        plain = inverted.model_copy(update={"inverted": False})
        np.testing.assert_array_equal(read_mask(root / view.mask), ~volume_mask(camera, plain))


def test_truth_masks_of_an_object_come_from_its_hull(bench):
    cameras = arc_cameras(5, 120, 90, arc_deg=70)
    truth = put_truth(bench.store, cameras)
    request = {"kind": "object", "view": "view_002", "points": [middle_of_ball(bench.scene, 2)]}
    finer = FAST.model_copy(update={"voxels": 60})
    metadata, root = bench.author(request, config=finer, dilate=0.015, **{"posed-truth": truth})
    found = [read_mask(root / v.mask) for v in metadata.truth_views]
    exact = [volume_mask(c, sphere((0, 0, 0), BALL_RADIUS)) for c in cameras]
    assert recall(found, exact).min() > 0.97
    assert precision(found, exact).min() > 0.7


def test_scribbles_follow_the_surface_they_were_drawn_on(bench):
    scene = bench.scene
    # A stroke across the ball and the floor beside it, and its exact image in the next view by true depth.
    x, y = middle_of_ball(scene, 3)
    request = {"kind": "scribble", "view": "view_003", "path": [[x - 40, y + 20], [x + 40, y + 20]]}
    exact = {"radiance-field": field(bench.store, scene)}
    masks = bench.masks(request, **exact)
    drawn = masks[3]
    rows, columns = np.nonzero(drawn)
    points = scene.cameras[3].unproject(np.stack([columns, rows], -1) + 0.5, scene.depths[3][rows, columns])
    for i in (2, 4):
        xy, z = scene.cameras[i].project(points)
        column, row = xy.astype(int).T
        visible = scene.cameras[i].inside(xy, z)
        visible[visible] = np.abs(scene.depths[i][row[visible], column[visible]] - z[visible]) < 0.01
        assert masks[i][row[visible], column[visible]].mean() > 0.9
        assert masks[i].sum() < 2 * drawn.sum()


def test_a_scribble_without_a_path_depends_on_the_seed_alone(bench):
    first, second = (bench.masks({"kind": "scribble", "view": "view_003"})[3] for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert 0.02 < first.mean() < 0.5


def test_masks_of_the_capture_are_used_without_a_request_and_carried_where_missing(bench):
    known = (0, 2, 3, 5, 7)
    inputs = {"posed-capture": capture(bench.store, bench.scene, masked=known)}
    metadata, root = bench.author(None, **inputs)
    assert metadata.origin == "imported"
    masks = [read_mask(root / v.mask) for v in metadata.views]
    missing = [i for i in range(8) if i not in known]
    truth = bench.scene.object_masks
    assert recall([masks[i] for i in missing], truth[missing]).min() > 0.97
    assert precision([masks[i] for i in missing], truth[missing]).min() > 0.7
    for i in known:
        assert (masks[i] | ~truth[i]).all()
    assert metadata.consistency is not None


def test_dilation_grows_by_a_share_of_the_shorter_side(bench):
    inputs = {"posed-capture": capture(bench.store, bench.scene, masked=range(8))}
    plain, grown = (bench.masks({"kind": "imported"}, dilate=d, **inputs)[0] for d in (0.0, 0.05))
    distance = cv2.distanceTransform((~plain).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    np.testing.assert_array_equal(grown[distance <= 5.5], True)  # 0.05 of 120 is 6 pixels
    assert not grown[distance > 7].any()


def test_without_request_and_masks_the_run_waits_with_an_example_that_fits(bench):
    with pytest.raises(WaitingError, match=r"(?s)view: \"view_000\".*frame_size: \[160, 120\]"):
        bench.author(None)


@pytest.mark.parametrize(
    ("request_", "says"),
    [
        ({"kind": "object", "view": "view_02", "points": [[80, 60]]}, "did you mean 'view_002'"),
        ({"kind": "object", "view": "view_002", "points": [[160, 60]]}, r"\[160, 60\] is outside"),
        ({"kind": "object", "view": "view_002", "points": [[9, 9]], "frame_size": [120, 160]}, "has not the shape"),
        ({"kind": "scribble", "view": "nope", "path": [[80, 60]]}, "there is no view 'nope'"),
        ({"kind": "imported"}, "none of its views has one"),
        ({"kind": "sphere", "centre": [0, 0, 30], "radius": 0.1}, "in none of the 8 views"),
        ({"kind": "sphere", "centre": [0, 0, 0], "radius": 5.0}, "covers 100.0%"),
    ],
)  # fmt: skip
def test_requests_that_cannot_work_say_why(bench, request_, says):
    with pytest.raises(ConfigurationError, match=says):
        bench.author(request_)


def test_a_field_of_other_views_or_without_surfaces_is_refused(bench):
    fewer = synthetic_scene(views=5, width=32, height=24)
    with pytest.raises(BadInputError, match="no depth for 3 of 8 views"):
        bench.author({"kind": "scribble", "view": "view_003"}, **{"radiance-field": field(bench.store, fewer)})
    empty = {"radiance-field": field(bench.store, bench.scene, opaque=0.1)}
    with pytest.raises(BadInputError, match="no surface"):
        bench.author({"kind": "sphere"}, **empty)
    with pytest.raises(BadInputError, match="no surface"):
        bench.author({"kind": "scribble", "view": "view_003"}, **empty)


def test_maps_without_depth_are_refused_by_the_channels_that_they_have(tmp_path):
    write_exr(tmp_path / "maps.exr", {"opacity.A": np.ones((2, 3))})
    with pytest.raises(BadInputError, match=r"maps.exr has channels opacity.A but no depth.Z"):
        read_depth(tmp_path / "maps.exr")


def test_the_mask_set_is_written_for_every_view_at_its_size(bench):
    metadata, root = bench.author({"kind": "sphere"})
    assert [v.name for v in metadata.views] == bench.scene.names
    for view in metadata.views:
        mask = read_mask(root / view.mask, (160, 120))
        assert view.share == pytest.approx(mask.mean())


def test_write_mask_round_trips(tmp_path):
    mask = np.random.default_rng(0).random((5, 7)) > 0.5
    write_mask(tmp_path / "m.png", mask)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), mask)


@pytest.mark.parametrize(("share", "fills"), [(0.5, False), (0.9, False), (0.95, True), (1.0, True)])
def test_an_object_that_fills_its_view_is_refused(share: float, fills: bool) -> None:
    found = np.arange(400).reshape(20, 20) < share * 400
    if not fills:
        check_room_around(found, "view_003")
        return
    with pytest.raises(ConfigurationError, match=r"fills \d+% of view 'view_003'.*under `background`"):
        check_room_around(found, "view_003")
