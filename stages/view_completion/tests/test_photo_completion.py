"""Pictures of what lies behind the hole, on the synthetic room, whose picture without the ball is known."""

import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES
from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.radiance.appearance import AppearanceMap
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.paintings import Painting
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.view_completion.config import PhotoCompletion
from inpaint3d.stages.view_completion.photo_completion import complete_from_photos

NO_CODES = AppearanceMap(None)
THREE = PhotoCompletion(max_reference_views=3)


@pytest.fixture(scope="module")
def large() -> SyntheticScene:
    return synthetic_scene(views=8, width=96, height=72)


def views_of(room: SyntheticScene) -> list[MaskedView]:
    return [
        MaskedView(n, c, np.where(m[..., None], 0, i).astype(np.float32), m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]


def depths_of(room: SyntheticScene) -> dict[str, np.ndarray]:
    return {n: d.astype(np.float32) for n, d in zip(room.names, room.empty_depths, strict=True)}


def error(room: SyntheticScene, pictures: list[np.ndarray]) -> float:
    apart = [np.abs(p - e)[m] for p, e, m in zip(pictures, room.empty_images, room.object_masks, strict=True)]
    return float(np.concatenate(apart).mean())


def test_what_others_show_is_recovered_as_it_is(large: SyntheticScene) -> None:
    """With the true depth behind the ball the pictures come far nearer to the empty room than a smooth filling."""
    views = views_of(large)
    made, words, references, _ = complete_from_photos(
        views, depths_of(large), large.points.xyz, NO_CODES, THREE, seed=0
    )
    pictures = [one.picture for one in made]
    smooth = [fill_telea(v.image, v.hole) for v in views]
    assert error(large, pictures) < 0.6 * error(large, smooth)
    assert words.endswith(tuple(references))
    assert set(references) <= set(large.names)
    for view, picture in zip(views, pictures, strict=True):
        np.testing.assert_array_equal(picture[view.known], view.image[view.known])


def test_what_is_made_up_is_the_same_from_every_view(large: SyntheticScene) -> None:
    """A point of the floor under the ball has one colour, however many views it is seen from."""
    views = views_of(large)
    made, _, _, _ = complete_from_photos(views, depths_of(large), large.points.xyz, NO_CODES, THREE, seed=0)
    pictures = [one.picture for one in made]
    smooth = [fill_telea(v.image, v.hole) for v in views]
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    floor = np.stack([0.05 * np.cos(angles), 0.05 * np.sin(angles), np.full(24, -0.2)], -1)

    def spread(shown: list[np.ndarray]) -> float:
        colours = []
        for view, picture in zip(views, shown, strict=True):
            x, y = view.camera.project(floor)[0].astype(int).T
            assert view.hole[y, x].all()
            colours.append(picture[y, x])
        return float(np.std(colours, 0).mean())

    assert spread(pictures) < 0.5 * spread(smooth)


def lose_floor(room: SyntheticScene) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """By view depths that are wrong where only masks look, under the ball; and where that is."""
    lost, under = {}, {}
    for name, camera, hole, depth in zip(room.names, room.cameras, room.object_masks, room.empty_depths, strict=True):
        points = camera.unproject(camera.pixel_centres(), depth)
        under[name] = hole & (np.hypot(points[..., 0], points[..., 1]) < 0.2)
        assert under[name].any()
        lost[name] = np.where(under[name], 0.4 * depth, depth).astype(np.float32)
    return lost, under


def test_a_surface_that_no_photo_shows_is_spanned_and_carried(large: SyntheticScene) -> None:
    """A field's depth says nothing where only masks look; the floor there is found from what lies around.

    Carried to another view it lies on the floor as exactly as where it was spanned: what is off lands beside.
    """
    views, (lost, under) = views_of(large), lose_floor(large)
    made, _, _, _ = complete_from_photos(views, lost, large.points.xyz, NO_CODES, THREE, seed=0)
    heights: list[np.ndarray] = []
    for view, one, depth in zip(views, made, large.empty_depths, strict=True):
        assert one.depth is not None
        wrong = np.abs(lost[view.name] / depth - 1)[view.hole]
        left = np.abs(one.depth / depth - 1)[view.hole]
        assert left.mean() < 0.25 * wrong.mean()
        points = view.camera.unproject(view.camera.pixel_centres(), one.depth)[under[view.name]]
        heights.append(points[:, 2] + 0.2)
    assert np.median(np.abs(np.concatenate(heights))) < 5e-4


def test_a_soft_depth_is_made_flat_where_points_say_so(large: SyntheticScene) -> None:
    """Fields are unsure of what they hardly see; sparse points of floor and walls around it are not."""
    views, rng = views_of(large), np.random.default_rng(0)
    soft = {n: (d * (1 + 0.02 * rng.standard_normal(d.shape))).astype(np.float32) for n, d in depths_of(large).items()}
    nothing = np.zeros((0, 3), np.float32)
    apart = {}
    for name, points in (("with", large.points.xyz), ("without", nothing)):
        made, _, _, _ = complete_from_photos(views, soft, points, NO_CODES, THREE, seed=0)
        off = [
            np.abs(one.depth / true - 1)[view.hole]
            for view, one, true in zip(views, made, large.empty_depths, strict=True)
            if one.depth is not None
        ]
        apart[name] = (np.median(np.concatenate(off)), error(large, [one.picture for one in made]))
    assert apart["with"][0] < 0.5 * apart["without"][0]
    assert apart["with"][1] < apart["without"][1]


def test_known_elsewhere_or_made_up_is_told_apart(large: SyntheticScene) -> None:
    """With depth on the ball itself no other photo knows what is masked: all of it has to be made up."""
    views = views_of(large)
    true, wrong = (
        complete_from_photos(views, depths, large.points.xyz, NO_CODES, PhotoCompletion(max_reference_views=1), seed=0)[
            1
        ]
        for depths in (depths_of(large), dict(zip(large.names, large.depths.astype(np.float32), strict=True)))
    )
    share, none = (int(words.split("%")[0]) for words in (true, wrong))
    assert share > 30
    assert none < 15


def test_every_filled_pixel_says_where_it_came_from(large: SyntheticScene) -> None:
    """All of the hole and nothing else; a pixel that is a photo's has the colour that the photo has there."""
    views = views_of(large)
    made, _, _, _ = complete_from_photos(views, depths_of(large), large.points.xyz, NO_CODES, THREE, seed=0)
    for view, one in zip(views, made, strict=True):
        np.testing.assert_array_equal(one.sources > 0, view.hole)
    sources = np.concatenate([one.sources[one.sources > 0] for one in made])
    photos = sources[sources >= FIRST_PHOTO]
    assert len(photos) > 0.3 * len(sources)
    assert photos.max() < FIRST_PHOTO + len(views)
    assert (sources == SOURCE_CODES["example"]).any()
    view, one, depth = views[0], made[0], large.empty_depths[0]
    for index in np.unique(one.sources[one.sources >= FIRST_PHOTO]) - FIRST_PHOTO:
        assert index != 0
        y, x = np.nonzero(one.sources == FIRST_PHOTO + index)
        points = view.camera.unproject(np.stack([x + 0.5, y + 0.5], -1), depth[y, x])
        xy, _ = views[index].camera.project(points)
        apart = np.abs(one.picture[y, x] - sample_bilinear(views[index].image, xy)).max(-1)
        assert np.median(apart) < 0.02


def test_what_is_painted_in_one_view_is_carried_to_the_others(large: SyntheticScene) -> None:
    """Where the painted view sees the surface, also over what other photos show; known pixels stay the photo's."""
    views = views_of(large)
    painted = np.broadcast_to(np.array([1.0, 0.0, 1.0], np.float32), views[0].image.shape)
    everywhere = np.ones_like(views[0].hole)
    made, words, _, _ = complete_from_photos(
        views,
        depths_of(large),
        large.points.xyz,
        NO_CODES,
        THREE,
        seed=0,
        paintings={views[0].name: Painting(painted, everywhere)},
    )
    assert f"as painted in {views[0].name}" in words
    assert (made[0].sources[views[0].hole] == SOURCE_CODES["painted"]).all()
    for view, one in zip(views, made, strict=True):
        np.testing.assert_array_equal(one.picture[view.known], view.image[view.known])
        carried = one.sources == SOURCE_CODES["painted"]
        np.testing.assert_allclose(one.picture[carried].mean(0), [1, 0, 1], atol=0.1)
    others = list(zip(views[1:], made[1:], strict=True))
    share = np.mean([(one.sources == SOURCE_CODES["painted"])[view.hole].mean() for view, one in others])
    assert share > 0.3


def test_of_two_paintings_of_one_place_the_nearest_counts_and_the_contradiction_is_said(large: SyntheticScene) -> None:
    views = views_of(large)
    first, second = (np.broadcast_to(np.array(c, np.float32), views[0].image.shape) for c in ((1, 0, 1), (0, 1, 0)))
    everywhere = np.ones_like(views[0].hole)
    made, _, _, contradictions = complete_from_photos(
        views, depths_of(large), large.points.xyz, NO_CODES, THREE, seed=0,
        paintings={views[0].name: Painting(first, everywhere), views[7].name: Painting(second, everywhere)},
    )  # fmt: skip
    for index, colour in ((0, (1, 0, 1)), (7, (0, 1, 0))):
        np.testing.assert_allclose(made[index].picture[views[index].hole].mean(0), colour, atol=1e-6)
    for index, colour in ((1, (1, 0, 1)), (6, (0, 1, 0))):
        carried = made[index].sources == SOURCE_CODES["painted"]
        np.testing.assert_allclose(np.median(made[index].picture[carried], 0), colour, atol=0.05)
    (found,) = contradictions
    assert found.names == (views[0].name, views[7].name)
    assert found.shared > 0.2
    assert found.difference == pytest.approx(1, abs=0.1)


def test_what_is_copied_by_example_is_noted_to_the_pixel(large: SyntheticScene) -> None:
    """Where nothing was evened out the picture is what the noted pixel shows; copies lie outside what they fill."""
    views = views_of(large)
    made, _, references, _ = complete_from_photos(views, depths_of(large), large.points.xyz, NO_CODES, THREE, seed=0)
    noted = [one for one in made if one.copies is not None]
    assert {one.name for one in noted} == set(references)
    for one in noted:
        copies = one.copies
        assert copies is not None
        copied = (copies >= 0).all(-1)
        assert (one.sources[copied] == SOURCE_CODES["example"]).all()
        x, y = copies[copied].astype(int).T
        assert not copied[y, x].any()
        assert np.median(np.abs(one.picture[copied] - one.picture[y, x])) < 0.1


def test_a_view_that_is_all_hole_keeps_the_surface_of_the_field() -> None:
    """Nothing sure is left to span a surface from: 1 / 0 would put it at infinity, and rays to it with it."""
    room = synthetic_scene(views=4)
    views, depths = views_of(room), depths_of(room)
    everything = np.ones_like(views[1].hole)
    views[1] = MaskedView(views[1].name, views[1].camera, 0 * views[1].image, everything, ~everything)
    made, _, _, _ = complete_from_photos(views, depths, room.points.xyz, NO_CODES, THREE, seed=0)
    assert all(
        one.depth is not None and np.isfinite(one.depth).all() and np.isfinite(one.picture).all() for one in made
    )
