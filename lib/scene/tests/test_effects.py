"""Each effect is found where it was put in, and is not where it was not."""

import pkgutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from inpaint3d.contracts.models.artifacts import Interval
from inpaint3d.scene import effects
from inpaint3d.scene.capture_io import View, write_view
from inpaint3d.scene.colour import linear_from_srgb, srgb_from_linear
from inpaint3d.scene.effects import (
    anti_aliasing,
    blur,
    contraction,
    exposure,
    intervals,
    lens_distortion,
    rolling_shutter,
    transients,
    view_dependence,
    vignetting,
)
from inpaint3d.scene.effects.description import Description, Finding, decide
from inpaint3d.scene.effects.evidence import Evidence
from inpaint3d.scene.effects.gains import explained, fit_folds, fit_gains, measure_rest
from inpaint3d.scene.synthetic import synthetic_scene

COUNT = 10
ROOM = synthetic_scene(views=COUNT, width=160, height=120, arc_deg=60, points=600)
INTERFACE = {"description", "evidence", "gains", "intervals"}


def look(folder, images=None, points=ROOM.points, *, ordered=True):
    """The evidence of the room, its pictures or points altered."""
    views = []
    for index, (name, camera) in enumerate(zip(ROOM.names, ROOM.cameras, strict=True)):
        write_view(folder, name, (ROOM.images if images is None else images)[index], camera)
        views.append(View(name, camera, "train", None, folder / "frames" / f"{name}.png"))
    return Evidence.of(views, points, ordered=ordered)


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    return look(tmp_path_factory.mktemp("plain"))


def state(module, evidence, forced=None):
    return decide(module.EFFECT, module.measure(evidence), forced or {}).state


def test_without_an_order_neighbours_are_the_nearest_views(plain):
    loose = replace(plain, ordered=False).neighbours
    for view, others in enumerate(loose.tolist()):
        away = {k: np.linalg.norm(v.camera.centre - plain.views[view].camera.centre) for k, v in enumerate(plain.views)}
        assert others == sorted(away, key=away.__getitem__)[1:3]
    pair = replace(plain, views=plain.views[:2], ordered=False)
    assert pair.neighbours.tolist() == [[1, 1], [0, 0]]


def test_every_module_is_an_effect_and_every_effect_a_module():
    modules = {m.name for m in pkgutil.iter_modules(effects.__path__)} - INTERFACE
    assert {name.replace("-", "_") for name in effects.DECIDED_IN} == modules
    for name, stage in effects.DECIDED_IN.items():
        module = effects.load(name)
        assert module.EFFECT.name == name
        assert hasattr(module, "measure") == (stage in ("scene-analysis", "pose-estimation"))


def test_a_name_that_there_is_not_is_no_effect():
    with pytest.raises(KeyError, match="fog"):
        effects.load("fog")


@pytest.mark.parametrize("name", effects.decided_in("scene-analysis"))
def test_an_ideal_camera_in_a_dull_room_calls_for_nothing(plain, name):
    assert state(effects.load(name), plain) == "off"


@pytest.mark.parametrize(
    ("low", "gain", "simulated", "decided"),
    [(0.6, 0.2, "a.b", "on"), (0.4, 0.2, "a.b", "off"), (0.6, 0.0, "a.b", "off"), (0.6, 0.2, None, "noticed")],
)
def test_an_effect_is_on_where_size_and_gain_are_certain(low, gain, simulated, decided):
    described = Description("e", "", "", "", simulated, material=0.5, least_gain=0.1)
    found = Finding("words", Interval(value=1, low=low, high=2), Interval(value=1, low=gain, high=2))
    assert decide(described, found, {}).state == decided
    assert decide(described, found, {"e": False}).state == "forced-off"
    assert decide(described, found, {"e": True}).reason == "by hand; measured: words"


@pytest.mark.parametrize("unknown", [True, False])
def test_a_capture_too_small_to_tell_takes_what_each_effect_says(unknown):
    described = Description("e", "", "", "", "a.b")
    assert decide(described, Finding("too small", unknown=unknown), {}).active == unknown


def test_too_few_points_are_said(tmp_path):
    few = look(tmp_path, points=ROOM.points.select(np.arange(len(ROOM.points)) < 15))
    for name in effects.decided_in("scene-analysis"):
        found = effects.load(name).measure(few)
        assert found.size is None
        assert "only" in found.words or "too few" in found.words


def test_the_jackknife_of_a_mean_is_its_standard_error():
    values = np.random.default_rng(0).normal(0, 1, 2000)
    found = intervals.jackknife(lambda kept: float(values[kept].mean()), len(values), "")
    half = intervals.SPREAD / np.sqrt(len(values))
    assert found.high - found.value == pytest.approx(half, rel=0.6)  # of ten groups, itself uncertain by a quarter
    assert found.low + found.high == pytest.approx(2 * found.value)


def gain_table(truth, noise=0.05, points=300, seed=0, per_point=6):
    """Each point seen by a run of neighbouring views, as along a path."""
    rng, views = np.random.default_rng(seed), len(truth)
    values = rng.normal(-2, 1, points)[:, None] + truth + rng.normal(0, noise, (points, views))
    first = rng.integers(0, views - per_point + 1, points)[:, None]
    index = np.arange(views)
    return np.where((index >= first) & (index < first + per_point), values, np.nan)


def test_gains_are_recovered_along_a_path_where_no_point_is_seen_by_all_views():
    truth = np.linspace(-1, 1, 40) + 0.2 * np.sin(np.arange(40))
    np.testing.assert_allclose(fit_gains(gain_table(truth)), truth - np.median(truth), atol=0.1)  # noise adds up


def test_wrong_matches_hardly_move_gains():
    truth = np.random.default_rng(1).normal(0, 0.3, 20)
    table = gain_table(truth)
    wrong = np.random.default_rng(2).random(table.shape) < 0.05
    np.testing.assert_allclose(fit_gains(np.where(wrong, table + 3, table)), truth - np.median(truth), atol=0.1)


@pytest.mark.parametrize("offset", [-8.0, 0.0, 8.0])
def test_gains_do_not_depend_on_how_bright_the_scene_is(offset):
    table = gain_table(np.array([0.0, 0.4, -0.2, 0.1, 0, 0, 0.3]))
    np.testing.assert_allclose(fit_gains(table + offset), fit_gains(table), atol=1e-8)


def test_gains_explain_held_out_points_only_where_there_are_gains():
    truth = np.random.default_rng(3).normal(0, 0.3, 12)
    _, _, real = fit_folds(gain_table(truth))
    _, _, none = fit_folds(gain_table(0 * truth))
    assert real.low > 0.8
    assert none.high < 0.02


def test_what_is_left_about_a_points_mean_is_its_variance():
    values = np.random.default_rng(4).normal(0, 0.01, (500, 9))
    assert np.nanmean(measure_rest(values)) == pytest.approx(1e-4, rel=0.1)
    assert np.isnan(measure_rest(np.array([[1.0, np.nan], [np.nan, np.nan]]))).all()


def test_nothing_seen_gives_zeros():
    assert (fit_gains(np.full((3, 4), np.nan)) == 0).all()


def test_points_that_nobody_sees_change_no_gain():
    table = gain_table(np.array([0.0, 0.4, -0.2, 0.1, 0, 0, 0.3]))
    unseen = np.full((3, table.shape[1]), np.nan)
    np.testing.assert_allclose(fit_gains(np.concatenate([unseen, table])), fit_gains(table), rtol=0, atol=1e-12)


def test_of_no_spread_nothing_is_explained():
    assert np.isnan(explained(np.zeros(3), np.zeros(3)))
    gains, _, share = fit_folds(np.full((30, 6), -2.0))
    assert (gains == 0).all()
    assert (share.value, share.low, share.high) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("folds", [[], [np.nan], [0.5], [0.5, np.nan, np.inf]])
def test_a_single_fold_has_no_interval(folds):
    found = intervals.mean_of_folds(np.array(folds), "")
    assert (found.value, found.low, found.high) == (0.0, 0.0, 0.0)


def test_folds_without_a_figure_do_not_count():
    some = intervals.mean_of_folds(np.array([0.4, np.nan, 0.6]), "")
    assert some == intervals.mean_of_folds(np.array([0.4, 0.6]), "")
    assert some.value == pytest.approx(0.5)
    assert some.low < 0.4


@pytest.mark.parametrize("channels", [(1, 1, 1), (1, 0, -1)])
def test_exposure_and_white_balance_that_drift_are_found_and_measured(tmp_path, channels):
    gains = 2.0 ** (np.linspace(-0.3, 0.3, COUNT)[:, None] * np.array(channels))
    bright = srgb_from_linear(linear_from_srgb(ROOM.images) * gains[:, None, None]).astype(np.float32)
    evidence = look(tmp_path, bright)
    found = exposure.measure(evidence)
    assert state(exposure, evidence) == "on"
    assert found.size is not None
    assert found.size.value == pytest.approx(0.48, abs=0.06)  # 80 % of 0.6
    assert state(view_dependence, evidence) == "off"
    assert state(vignetting, evidence) == "off"


def test_vignetting_is_measured_in_ev_at_the_corner(tmp_path):
    middle = np.array([80.0, 60.0])
    away = np.linalg.norm((ROOM.cameras[0].pixel_centres() - middle) / np.linalg.norm(middle), axis=-1)
    dark = srgb_from_linear(linear_from_srgb(ROOM.images) * (2.0 ** (-0.5 * away**2))[..., None]).astype(np.float32)
    evidence = look(tmp_path, dark)
    found = vignetting.measure(evidence)
    assert found.size is not None
    assert found.size.value == pytest.approx(0.5, abs=0.1)
    assert state(vignetting, evidence) == "noticed"


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_does_not_darken_corners(value):
    square = np.random.default_rng(7).uniform(0, 1, (50, 4))
    values, known = -0.5 * square, square.copy()
    known[::5, 1] = value
    assert vignetting.fit_slope(values, known) == pytest.approx(0.5)
    values[1::5, 2] = value
    assert vignetting.fit_slope(values, known) == pytest.approx(0.5)


def test_points_at_one_distance_from_the_middle_tell_nothing_of_corners():
    values = np.random.default_rng(7).normal(0, 1, (50, 4))
    assert vignetting.fit_slope(values, np.full((50, 4), 0.25)) == 0
    assert vignetting.fit_slope(np.full((50, 4), np.nan), values) == 0


def test_a_lobe_is_told_by_near_views_and_noise_is_not():
    rng = np.random.default_rng(3)
    angle = np.deg2rad(np.arange(31) * 5.9)  # cameras on a half circle round the points
    directions = np.broadcast_to(np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1), (200, 31, 3))
    peak = rng.uniform(0, np.pi, (200, 1))
    lobe = 0.6 * np.exp(-0.5 * ((angle - peak) / np.deg2rad(20)) ** 2)
    noise = rng.normal(0, 0.05, (200, 31))
    assert view_dependence.predict_by_neighbours(lobe + noise, directions).min() > 0.3
    assert view_dependence.predict_by_neighbours(noise, directions).max() < 0.0
    point, difference, far = view_dependence.list_pairs(noise, directions)
    assert set(point) == set(range(200))
    near, apart = (np.quantile(difference[where], 0.8) for where in (~far, far))
    assert near == pytest.approx(1.2816 * 0.05 * np.sqrt(2), rel=0.1)  # 80 % of |differences| of normal noise
    assert apart == pytest.approx(near, rel=0.1)


def test_a_value_without_others_is_predicted_by_nobody():
    directions = np.broadcast_to(np.eye(3), (20, 3, 3))
    alone = np.where(np.arange(3) == 1, -2.0, np.nan)
    assert np.isnan(view_dependence.predict_by_neighbours(np.tile(alone, (20, 1)), directions)).all()


def test_a_contracted_cell_is_twice_a_box_of_the_unit_ball_and_finer_than_a_large_one():
    inside = np.array([[0.5, 0.0, 0.0]])
    assert contraction.gained_bits(inside, 1.0)[0] == pytest.approx(-1)
    assert contraction.gained_bits(inside, 16.0)[0] == pytest.approx(3)
    assert contraction.gained_bits(np.array([[3.0, 0, 0]]), 2.0)[0] == contraction.OUTSIDE_BITS


@pytest.mark.parametrize(("reach", "decided"), [(1.0, "off"), (6.0, "on")])
def test_a_far_background_calls_for_contraction(plain, reach, decided):
    xyz = ROOM.points.xyz.copy()
    xyz[::4] *= reach
    assert state(contraction, replace(plain, points=replace(ROOM.points, xyz=xyz))) == decided


def hide(evidence, view, left, right):
    """Points between two columns of a view are behind something: lost, and of another colour."""
    x = evidence.xy[:, view, 0]
    behind = (x >= left) & (x < right)
    tracked, colour = evidence.tracked.copy(), evidence.colour.copy()
    tracked[behind, view] = False
    colour[behind, view] = (0.9, 0.1, 0.9)
    return replace(evidence, tracked=tracked, colour=colour)


def test_somebody_who_walks_by_is_masked_where_he_is(plain):
    evidence = hide(plain, 4, 60, 100)
    assert state(transients, evidence) == "on"
    masks = transients.mask_transients(evidence)
    assert set(masks) == {ROOM.names[4]}
    mask = masks[ROOM.names[4]]
    assert mask[:, 60:100].mean() > 0.4  # where points are
    assert mask[:, :40].mean() < 0.05
    assert mask[:, 120:].mean() < 0.05


def test_single_points_that_are_missed_are_nobody(plain):
    rng = np.random.default_rng(5)
    missed = rng.random(plain.tracked.shape) < 0.02
    assert state(transients, replace(plain, tracked=plain.tracked & ~missed)) == "off"


def test_blurred_views_are_named_and_never_too_many(tmp_path):
    images = ROOM.images.copy()
    for index in (2, 5):
        images[index] = cv2.GaussianBlur(images[index], (0, 0), 3.0)
    evidence = look(tmp_path / "some", images)
    assert state(blur, evidence) == "on"
    assert set(blur.find_blurred(evidence)) == {ROOM.names[2], ROOM.names[5]}
    for index in (1, 3, 7):
        images[index] = cv2.GaussianBlur(images[index], (0, 0), 2.0)
    assert len(blur.find_blurred(look(tmp_path / "many", images))) <= blur.LARGEST_SHARE * COUNT + 1


@pytest.mark.parametrize("grey", [0.0, 0.4])
def test_bare_surfaces_are_neither_sharp_nor_blurred(tmp_path, grey):
    evidence = look(tmp_path, np.full_like(ROOM.images, grey))
    assert np.isfinite(evidence.sharpness).any()
    np.testing.assert_allclose(evidence.sharpness[np.isfinite(evidence.sharpness)], 0, atol=1e-3)
    assert blur.find_blurred(evidence) == []


def test_brighter_views_are_not_sharper(tmp_path):
    images = srgb_from_linear(linear_from_srgb(ROOM.images) * np.linspace(0.5, 1, COUNT)[:, None, None, None])
    assert state(blur, look(tmp_path, images.astype(np.float32))) == "off"


@pytest.mark.parametrize("readout", [0.0, 0.3])
def test_a_readout_is_measured_from_residuals(plain, readout):
    _, skew = rolling_shutter.list_skews(plain)
    noise = np.random.default_rng(6).normal(0, 0.2, skew.shape)
    rolled = replace(plain, residual=readout * skew + noise)
    found = rolling_shutter.measure(rolled)
    assert found.size is not None
    assert found.size.value == pytest.approx(readout, abs=0.02)
    assert state(rolling_shutter, rolled) == ("noticed" if readout else "off")


def test_matches_that_are_not_finite_tell_nothing_of_rows(plain):
    _, skew = rolling_shutter.list_skews(plain)
    residual = 0.3 * skew + np.random.default_rng(6).normal(0, 0.2, skew.shape)
    known = np.argwhere(np.isfinite(residual).all(-1))
    broken, unknown = residual.copy(), residual.copy()
    for values, value in ((broken, np.inf), (unknown, np.nan)):
        values[tuple(known[:-600].T)] = value
    assert rolling_shutter.fit_readout(broken, skew) == rolling_shutter.fit_readout(unknown, skew)
    broken[tuple(known[:-499].T)] = np.inf
    assert rolling_shutter.measure(replace(plain, residual=broken)).words.startswith("only 499 matches")


def test_cameras_that_do_not_move_tell_nothing_of_rows():
    residual = np.random.default_rng(6).normal(0, 0.2, (600, 5, 2))
    assert rolling_shutter.fit_readout(residual, np.zeros_like(residual)) == 0
    assert rolling_shutter.fit_readout(np.full_like(residual, np.nan), residual) == 0


def test_points_behind_a_neighbouring_camera_have_no_velocity(plain):
    """They project to where nothing is seen, mirrored."""
    camera = plain.views[4].camera
    turned = replace(camera, world_from_cam=np.concatenate([-camera.rotation, camera.centre[:, None]], 1))
    views = [*plain.views[:5], replace(plain.views[5], camera=turned), *plain.views[6:]]
    _, skew = rolling_shutter.list_skews(plain)
    assert np.isfinite(skew[:, 4]).any()
    assert np.isnan(rolling_shutter.list_skews(replace(plain, views=views))[1][:, 4]).all()


def test_photos_without_an_order_tell_nothing_of_rows(plain):
    assert rolling_shutter.measure(replace(plain, ordered=False)).size is None


def test_footprints_are_ratios_of_distances(plain):
    octaves = anti_aliasing.list_octaves(plain)
    centres = np.stack([v.camera.centre for v in plain.views])
    away = np.linalg.norm(plain.xyz[0] - centres, axis=-1)[plain.tracked[0]]
    assert octaves[0] == pytest.approx(np.log2(away.max() / away.min()))


@pytest.mark.parametrize(
    ("errors", "corner", "decided"),
    [((0.7, 0.6), 12.0, "on"), ((0.6, 0.6), 12.0, "off"), ((0.7, 0.6), 0.05, "off")],
)
def test_a_lens_bends_where_the_corner_moves_and_bic_says_so(errors, corner, decided):
    flat, bent = (
        lens_distortion.LensTrial(name, k, error, c)
        for name, k, error, c in (("PINHOLE", 0, errors[0], 0.0), ("SIMPLE_RADIAL", 1, errors[1], corner))
    )
    found = lens_distortion.measure(flat, bent, 4000)
    assert decide(lens_distortion.EFFECT, found, {}).state == decided


@pytest.mark.parametrize(("simple", "rich"), [(0.0, 0.0), (0.5, 0.0), (1e-9, 1e-300)])
def test_errors_of_nothing_are_as_good_as_none(simple, rich):
    """The fit of a made-up capture may be exact; what lies below the rounding of pixels tells nothing."""
    trials = [lens_distortion.LensTrial("x", 2 * k, e, 1.0) for k, e in enumerate((simple, rich))]
    found = lens_distortion.bic_gain(*trials, 1000.0)
    floored = 1000 * np.log(max(simple, 1e-6) / 1e-6) - np.log(1000)
    assert found == pytest.approx(floored)


def test_bic_of_equal_errors_is_the_penalty():
    same = lens_distortion.LensTrial("a", 0, 0.5, 0.0), lens_distortion.LensTrial("b", 3, 0.5, 0.0)
    assert lens_distortion.bic_gain(*same, matches=1000) == pytest.approx(-1.5 * np.log(1000))
