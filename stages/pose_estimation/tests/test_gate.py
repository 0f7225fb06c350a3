from dataclasses import replace

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.features import choose_pairs
from inpaint3d.stages.pose_estimation.gate import (
    Evidence,
    TooFewViewsError,
    check_estimated,
    check_known,
    check_spread,
)
from inpaint3d.stages.pose_estimation.matches import PairCounts
from inpaint3d.stages.pose_estimation.solve import look_harder

PAIRS = PairCounts(verified=150, turned=5, planar=3, still=0, median_matches=120)
GOOD = Evidence(
    given=20, registered=20, unregistered=(), model_sizes=[20], pairs=PAIRS, median_features=2000, points=900,
    angle_deg=12, error_px=0.8, longest_side=1000,
)  # fmt: skip


def test_a_good_capture_passes():
    check_estimated(GOOD, Config())
    check_estimated(replace(GOOD, pairs=replace(PAIRS, turned=60)), Config())  # before a papered wall
    check_known(GOOD, Config())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"registered": 4, "unregistered": ("a", "b")}, r"4 of 20 views could be placed, 12 are needed: 150 of 190"),
        ({"registered": 0, "pairs": replace(PAIRS, turned=140)}, r"140 of 150 matching pairs the camera only turned"),
        (
            {"pairs": replace(PAIRS, turned=100, planar=40)},
            r"140 of 150 .* pairs a turn on the spot .* or one plane",
        ),
        ({"registered": 0, "pairs": replace(PAIRS, planar=120)}, r"120 of 150 matching pairs all lies in one plane"),
        ({"registered": 0, "pairs": replace(PAIRS, still=110)}, r"110 of 150 .* hardly differ: the camera rested"),
        ({"registered": 0, "median_features": 12}, r"median of 12 features .dark, blurred, or bare surfaces"),
        ({"registered": 9, "model_sizes": [9, 8]}, r"2 models that do not meet .of 9, 8 views"),
        ({"angle_deg": 0.4}, r"angle is 0\.40 degrees.*walk sideways"),
        ({"points": 3}, r"only 3 points were found in 20 views"),
        ({"error_px": 9.5}, r"reprojection error is 9\.50 px at 1000 px wide, 4\.00 are allowed"),
    ],
)
def test_each_refusal_gives_its_figures(change, words):
    with pytest.raises(BadInputError, match=words):
        check_estimated(replace(GOOD, **change), Config())


def test_pictures_that_contradict_their_cameras_are_refused():
    with pytest.raises(BadInputError, match=r"150 pairs match with 120 inliers each, but only 4 points"):
        check_known(replace(GOOD, points=4), Config())
    # Bare walls match nothing; the cameras may still be right.
    nothing = replace(PAIRS, verified=0, median_matches=0)
    check_known(replace(GOOD, points=4, pairs=nothing), Config())


def test_a_second_try_is_made_only_where_it_may_help():
    with pytest.raises(TooFewViewsError):
        check_estimated(replace(GOOD, registered=4), Config())
    with pytest.raises(BadInputError) as refusal:
        check_estimated(replace(GOOD, registered=4, pairs=replace(PAIRS, turned=140)), Config())
    assert not isinstance(refusal.value, TooFewViewsError)
    harder = look_harder(Config(), 50)
    assert (harder.features, harder.feature_longest_side, harder.matching) == (8192, 960, "exhaustive")
    assert look_harder(Config(), 500).matching == "auto"


def test_a_camera_far_from_all_others_is_named():
    centres = np.array([[np.cos(a), np.sin(a), 0.3] for a in np.linspace(0, 3, 8)])
    names = [f"view_{i}" for i in range(8)]
    check_spread(centres, names)
    centres[5, 0] += 100
    with pytest.raises(BadInputError, match=r"stand those of view_5 .\d\d+ times as far as most"):
        check_spread(centres, names)


def test_small_sets_match_all_pairs_and_walks_their_neighbours():
    names = [f"{i:03d}" for i in range(40)]
    assert len(choose_pairs(names[:20], ordered=True, config=Config())) == 190
    assert len(choose_pairs(names, ordered=False, config=Config())) == 780
    walk = choose_pairs(names, ordered=True, config=Config())
    assert len(walk) == len(set(walk)) < 780
    assert ("000", "001") in walk
    assert ("000", "010") in walk
    assert ("000", "011") not in walk
    assert ("000", "020") in walk
    assert ("000", "039") in walk  # closes a loop
    assert all(a < b for a, b in walk)


def test_cameras_of_which_most_stand_in_one_point_have_no_far_one():
    """Of a tripod with a step aside: nothing is usual to be so many times as far as."""
    centres = np.zeros((5, 3))
    centres[4, 0] = 0.1
    check_spread(centres, [f"frame_{i}" for i in range(5)])
