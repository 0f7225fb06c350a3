from dataclasses import replace

import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.features import choose_pairs
from inpaint3d.stages.pose_estimation.gate import Evidence, check_estimated, check_known

GOOD = Evidence(
    given=20, registered=20, unregistered=(), model_sizes=[20], verified_pairs=150, turned_pairs=5,
    median_inliers=120, points=900, angle_deg=12, error_px=0.8, longest_side=1000,
)  # fmt: skip


def test_a_good_capture_passes():
    check_estimated(GOOD, Config())
    check_known(GOOD, Config())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"registered": 4, "unregistered": ("a", "b")}, r"4 of 20 views could be placed, 12 are needed: 150 of 190"),
        ({"registered": 0, "turned_pairs": 140}, r"140 of 150 matching pairs the camera only turned .pure rotation"),
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
    check_known(replace(GOOD, points=4, verified_pairs=0, median_inliers=0), Config())


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
