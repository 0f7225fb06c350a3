import numpy as np
import pytest

from inpaint3d.stages.scene_analysis.photometry import Observations, direction_effect, view_gains


def observations(gains, points=300, noise=0.05, per_point=6, seed=0, shine=None):
    """Each point seen by a run of neighbouring views, as along a path."""
    rng, views = np.random.default_rng(seed), len(gains)
    brightness = rng.normal(-2, 1, points)
    point = np.repeat(np.arange(points), per_point)
    view = (rng.integers(0, views - per_point + 1, points)[:, None] + np.arange(per_point)).ravel()
    value = brightness[point] + np.asarray(gains)[view] + rng.normal(0, noise, len(point))
    return Observations(point, view, value if shine is None else value + shine(point, view))


def test_gains_are_recovered_along_a_path_where_no_point_is_seen_by_all_views():
    truth = np.linspace(-1, 1, 40) + 0.2 * np.sin(np.arange(40))
    found = view_gains(observations(truth), 40)
    np.testing.assert_allclose(found, truth - np.median(truth), atol=0.1)  # noise adds up along the path


def test_wrong_matches_hardly_move_gains():
    truth = np.random.default_rng(1).normal(0, 0.3, 20)
    clean = observations(truth)
    wrong = np.random.default_rng(2).random(len(clean.point)) < 0.05
    spoilt = Observations(clean.point, clean.view, np.where(wrong, clean.log2_luma + 3, clean.log2_luma))
    np.testing.assert_allclose(view_gains(spoilt, 20), truth - np.median(truth), atol=0.1)


def test_one_observation_of_a_point_says_nothing_of_gains():
    alone = Observations(np.arange(5), np.arange(5), np.array([0.0, 1, 2, 3, 4]))
    np.testing.assert_allclose(view_gains(alone, 5), 0, atol=1e-9)


def test_a_view_without_observations_has_no_gain():
    found = view_gains(observations([0.0, 0.5, 0, 0, 0, 0, 0]), 9)
    assert np.isnan(found[7:]).all()
    assert np.isfinite(found[:7]).all()


@pytest.mark.parametrize("offset", [-8.0, 0.0, 8.0])
def test_gains_do_not_depend_on_how_bright_the_scene_is(offset):
    seen = observations(np.array([0.0, 0.4, -0.2, 0.1, 0, 0, 0.3]))
    shifted = Observations(seen.point, seen.view, seen.log2_luma + offset)
    np.testing.assert_allclose(view_gains(shifted, 7), view_gains(seen, 7), atol=1e-8)


def test_direction_effect_tells_a_reflection_from_noise():
    # 31 cameras on a half circle round the origin, 6 degrees apart; each point has a lobe of 0.6 EV and 20 degrees.
    angle = np.deg2rad(np.arange(31) * 5.9)
    centres = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)
    peak = np.random.default_rng(3).uniform(0, np.pi, 400)

    def shine(point, view):
        return 0.6 * np.exp(-0.5 * ((angle[view] - peak[point]) / np.deg2rad(20)) ** 2)

    xyz, gains = np.zeros((400, 3)), np.zeros(31)
    dull = direction_effect(observations(gains, 400, per_point=20), gains, xyz, centres)
    shiny = direction_effect(observations(gains, 400, per_point=20, shine=shine), gains, xyz, centres)
    assert dull[0] == pytest.approx(1.2816 * 0.05 * np.sqrt(2), rel=0.1)  # 80 % of |differences| of normal noise
    assert dull[1] == pytest.approx(dull[0], rel=0.1)
    assert shiny[1] > 2 * shiny[0]
    assert dull[2] > 1000


def test_nothing_seen_gives_zeros():
    none = Observations(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))
    assert direction_effect(none, np.zeros(3), np.zeros((0, 3)), np.zeros((3, 3))) == (0.0, 0.0, 0)
    assert np.isnan(view_gains(none, 3)).all()
