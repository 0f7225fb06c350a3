import numpy as np
import pytest
from numpy.typing import NDArray

from inpaint3d.scene.morphology import (
    close,
    fill_holes,
    grow,
    grow_square,
    keep_parts_at,
    label_parts,
    remove_specks,
    shrink,
)

Mask = NDArray[np.bool_]


def random_mask(seed: int, share: float) -> Mask:
    return np.random.default_rng(seed).random((17, 23)) < share


def reached(mask: Mask, radius: int, *, square: bool = False) -> Mask:
    """The slow truth: the mask set down at every offset of the structuring element."""
    padded, out = np.pad(mask, radius), np.zeros_like(mask)
    height, width = mask.shape
    for dy in range(-radius, radius + 1):
        for dx in range(-radius, radius + 1):
            if square or dx * dx + dy * dy <= radius * radius + radius:
                out |= padded[radius + dy : radius + dy + height, radius + dx : radius + dx + width]
    return out


@pytest.mark.parametrize("radius", range(9))
@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 1.0])
def test_growing_reaches_what_the_element_reaches(radius: int, share: float) -> None:
    mask = random_mask(radius, share)
    np.testing.assert_array_equal(grow(mask, radius), reached(mask, radius))
    np.testing.assert_array_equal(grow_square(mask, radius), reached(mask, radius, square=True))


@pytest.mark.parametrize("radius", [0, 1, 4])
def test_shrinking_is_growing_of_what_lies_outside_and_the_border_is_no_edge(radius: int) -> None:
    mask = random_mask(5, 0.98)
    np.testing.assert_array_equal(shrink(mask, radius), ~reached(~mask, radius))
    assert shrink(np.ones((9, 9), bool), radius).all()


def test_closing_fills_a_narrow_gap_up_to_the_border_and_takes_nothing_away() -> None:
    mask = np.ones((20, 30), bool)
    mask[:, 10:14] = mask[:, 20:29] = False
    closed = close(mask, 3)
    assert closed[:, :20].all()
    assert not closed[:, 24].any()
    lone = random_mask(2, 0.02)
    assert close(lone, 2)[lone].all()


def test_small_enclosed_gaps_are_filled_and_no_others() -> None:
    mask = np.zeros((20, 20), bool)
    mask[2:18, 2:18] = True
    mask[5:7, 5:7] = mask[9:16, 9:16] = mask[2:4, 10:12] = False
    filled = fill_holes(mask, 0.1)
    assert filled[5:7, 5:7].all(), "4 pixels"
    assert not filled[9:16, 9:16].any(), "49 of 199 pixels"
    assert not filled[2:4, 10:12].any(), "open to the outside"
    np.testing.assert_array_equal(filled[:2], mask[:2])


def test_a_gap_that_is_joined_to_the_outside_by_a_corner_alone_is_enclosed() -> None:
    mask = np.ones((5, 5), bool)
    mask[0, 0] = mask[1, 1] = False
    filled = fill_holes(mask, 1.0)
    assert filled[1, 1]
    assert not filled[0, 0]


def test_specks_go_and_parts_stay() -> None:
    """Two parts of an object that something stands before, and cells where depth was wrong."""
    mask = np.zeros((60, 80), bool)
    mask[10:50, 5:30] = True
    mask[20:40, 40:50] = True
    parts = mask.copy()
    mask[2:4, 60:64] = mask[55, 70] = True
    np.testing.assert_array_equal(remove_specks(mask, 0.02), parts)
    np.testing.assert_array_equal(remove_specks(mask, 0.0), mask)
    np.testing.assert_array_equal(remove_specks(mask, 0.5)[:, :35], parts[:, :35])
    assert not remove_specks(mask, 0.5)[:, 35:].any()


def test_no_mask_has_no_specks_and_no_parts() -> None:
    empty = np.zeros((4, 5), bool)
    assert not remove_specks(empty, 0.02).any()
    assert label_parts(empty)[1] == 0


def test_parts_are_told_apart_and_picked_by_their_pixels() -> None:
    mask = np.zeros((6, 8), bool)
    mask[0, 0] = mask[1, 1] = mask[4, 6] = True
    assert label_parts(mask)[1] == 2
    assert label_parts(mask, diagonal=False)[1] == 3
    kept = keep_parts_at(mask, np.array([[1, 1], [3, 3]]))
    assert kept.sum() == 2
    assert kept[0, 0]
