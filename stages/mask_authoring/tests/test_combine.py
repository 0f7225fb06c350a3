"""Masks put together of others, and volumes where a surface was clicked at."""

import numpy as np
import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.scene.image_io import read_mask
from inpaint3d.scene.synthetic import BALL_RADIUS
from inpaint3d.scene.volumes import box, sphere, volume_mask
from inpaint3d.stages.mask_authoring.consistency import measure_agreement
from inpaint3d.stages.mask_authoring.views import DepthView
from tests.mask_bench import FAST, Bench, field, make_bench, middle_of_ball

BALL = {"kind": "sphere", "centre": [0, 0, 0], "radius": BALL_RADIUS}
LEFT = {"kind": "sphere", "centre": [-0.2, 0, 0], "radius": 0.15}
POLE = {"kind": "box", "centre": [0, 0, 0.1], "size": [0.2, 0.2, 0.6]}


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Bench:
    return make_bench(tmp_path_factory.mktemp("store"))


def volumes(bench: Bench, *primitives) -> list[list[np.ndarray]]:
    return [[volume_mask(camera, one) for camera in bench.scene.cameras] for one in primitives]


def test_a_union_is_what_any_of_its_parts_masks(bench):
    ball, left = volumes(bench, sphere((0, 0, 0), BALL_RADIUS), sphere((-0.2, 0, 0), 0.15))
    metadata, _ = bench.author({"kind": "union", "of": [BALL, LEFT]})
    found = bench.masks({"kind": "union", "of": [BALL, LEFT]})
    np.testing.assert_array_equal(found, np.logical_or(ball, left))
    assert metadata.kind == "volume"
    assert len(metadata.primitives) == 2


def test_a_difference_takes_away_and_may_be_part_of_a_union(bench):
    ball, left, pole = volumes(
        bench, sphere((0, 0, 0), BALL_RADIUS), sphere((-0.2, 0, 0), 0.15), box((0, 0, 0.1), (0.2, 0.2, 0.6))
    )
    half = {"kind": "difference", "of": BALL, "minus": [POLE]}
    expected = np.logical_and(ball, np.logical_not(pole))
    np.testing.assert_array_equal(bench.masks(half), expected)
    np.testing.assert_array_equal(bench.masks({"kind": "union", "of": [half, LEFT]}), expected | np.array(left))


def test_what_a_difference_keeps_is_not_grown(bench):
    x, y = middle_of_ball(bench.scene, 2)
    scribble = {"kind": "scribble", "view": "view_002", "path": [[x - 30, y], [x + 30, y]]}
    request = {"kind": "difference", "of": scribble, "minus": [BALL]}
    (ball,) = volumes(bench, sphere((0, 0, 0), BALL_RADIUS))
    grown = bench.masks(scribble, dilate=0.05)
    np.testing.assert_array_equal(bench.masks(request, dilate=0.05), np.array(grown) & ~np.array(ball))


def test_named_objects_have_sets_of_their_own_and_are_removed_together_or_alone(bench):
    named = {"ball": BALL, "left": LEFT}
    ball, left = volumes(bench, sphere((0, 0, 0), BALL_RADIUS), sphere((-0.2, 0, 0), 0.15))
    np.testing.assert_array_equal(bench.masks({"kind": "objects", "named": named}), np.logical_or(ball, left))
    metadata, root = bench.author({"kind": "objects", "named": named, "remove": ["left"]})
    np.testing.assert_array_equal([read_mask(root / v.mask) for v in metadata.views], left)
    assert [(one.name, one.removed) for one in metadata.objects] == [("ball", False), ("left", True)]
    np.testing.assert_array_equal([read_mask(root / v.mask) for v in metadata.objects[0].views], ball)


def test_which_object_stands_before_which_is_known_for_each_view(bench):
    exact = {"radiance-field": field(bench.store, bench.scene)}
    # The wall is behind the ball in every view.
    wall = {"kind": "scribble", "view": "view_004", "path": [[10, 8], [40, 8]]}
    metadata, _ = bench.author({"kind": "objects", "named": {"wall": wall, "ball": BALL}}, **exact)
    shown = {order.name: order.front_to_back for order in metadata.occlusion}
    assert shown["view_004"] == ("ball", "wall")
    assert set(shown) == set(bench.scene.names)


@pytest.mark.parametrize(
    ("kind", "size"), [("sphere", {"radius": 0.2}), ("box", {"size": [0.2, 0.3, 0.2]})]
)  # fmt: skip
def test_a_volume_is_put_where_a_surface_was_clicked_at(bench, kind, size):
    exact = {"radiance-field": field(bench.store, bench.scene)}
    pixel = middle_of_ball(bench.scene, 3)
    metadata, _ = bench.author({"kind": kind, "surface": {"view": "view_003", "at": pixel}, **size}, **exact)
    (volume,) = metadata.primitives
    camera = bench.scene.cameras[3]
    z = bench.scene.depths[3][int(pixel[1]), int(pixel[0])]
    # Every second pixel has depth in the field's maps: the ball's surface one pixel beside it.
    np.testing.assert_allclose(volume.centre, camera.unproject(pixel, z), atol=0.02)
    assert np.linalg.norm(volume.centre) == pytest.approx(BALL_RADIUS, rel=0.05)
    wanted = [0.4, 0.4, 0.4] if kind == "sphere" else size["size"]
    np.testing.assert_allclose(volume.size, np.multiply(wanted, z), rtol=0.02)


def test_a_click_where_the_field_has_no_surface_is_refused(bench):
    empty = {"radiance-field": field(bench.store, bench.scene, opaque=0.1)}
    with pytest.raises(ConfigurationError, match=r"no surface at \[80.0, 60.0\] in view 'view_003'"):
        bench.author({"kind": "sphere", "surface": {"view": "view_003", "at": [80, 60]}}, **empty)


def test_views_that_do_not_show_the_mask_have_an_empty_one_and_full_ones_may_be(bench):
    # A sphere round one camera: full there, a hole or nothing elsewhere.
    centre = [float(v) for v in bench.scene.cameras[0].centre]
    metadata, root = bench.author({"kind": "sphere", "centre": centre, "radius": 0.05})
    shares = [view.share for view in metadata.views]
    assert shares[0] == 1.0
    assert min(shares) == 0.0
    assert read_mask(root / metadata.views[0].mask).all()


def test_an_object_pointed_at_on_two_views_is_found_from_both(bench):
    pointed = [{"view": f"view_00{i}", "points": [middle_of_ball(bench.scene, i)]} for i in (0, 7)]
    config = FAST.model_copy(update={"refine": False})
    one = bench.masks({"kind": "object", **pointed[0]}, config=config)
    two = bench.masks({"kind": "object", **pointed[0], "other_views": [pointed[1]]}, config=config)
    truth = bench.scene.object_masks[7]
    assert (one[7] & truth).sum() < 0.75 * truth.sum(), "the far side is not seen from the first view"
    assert (two[7] & truth).sum() > 0.95 * truth.sum()


def test_every_view_has_a_confidence_and_those_that_disagree_are_named(bench):
    metadata, _ = bench.author({"kind": "object", "view": "view_002", "points": [middle_of_ball(bench.scene, 2)]})
    assert all(view.confidence > 0.8 for view in metadata.views)
    assert metadata.views_to_check == ()


def test_a_view_whose_mask_is_elsewhere_is_one_to_look_at(bench):
    views = [
        DepthView(name, camera, depth, lambda: np.zeros((120, 160, 3), np.float32))
        for name, camera, depth in zip(bench.scene.names, bench.scene.cameras, bench.scene.depths, strict=True)
    ]
    masks = list(bench.scene.object_masks)
    assert measure_agreement(views, masks, 0.05).to_check(bench.scene.names) == ()
    masks[3] = np.roll(masks[3], 40, axis=1)
    moved = measure_agreement(views, masks, 0.05)
    assert moved.to_check(bench.scene.names) == ("view_003",)
    assert moved.views[3] == min(score for score in moved.views if score is not None)
