import numpy as np
import pytest

from inpaint3d.scene.selection import choose_evenly


def test_the_worked_example() -> None:
    assert choose_evenly("abcdefghij", 3) == ["a", "e", "j"]


@pytest.mark.parametrize("count", range(2, 9))
def test_ends_are_among_them_and_gaps_differ_by_one_at_most(count: int) -> None:
    chosen = choose_evenly(range(20), count)
    assert (len(chosen), chosen[0], chosen[-1]) == (count, 0, 19)
    assert np.ptp(np.diff(chosen)) <= 1


def test_all_the_middle_or_none() -> None:
    assert choose_evenly([5, 6, 7], 9) == choose_evenly([5, 6, 7], 3) == [5, 6, 7]
    assert choose_evenly([5, 6, 7], 1) == [6]
    assert choose_evenly([5, 6, 7], 0) == choose_evenly([], 3) == []
