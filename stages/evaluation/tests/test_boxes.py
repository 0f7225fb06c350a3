import numpy as np

from inpaint3d.stages.evaluation.boxes import Box, mask_box


def test_the_box_is_the_bounding_box_grown_by_half_on_each_side():
    mask = np.zeros((100, 120), bool)
    mask[40:60, 30:70] = True
    assert mask_box(mask, 0.0) == Box(30, 40, 70, 60)
    assert mask_box(mask, 0.1) == Box(28, 39, 72, 61)


def test_growth_stops_at_the_border():
    mask = np.zeros((30, 40), bool)
    mask[0:10, 35:40] = True
    assert mask_box(mask, 1.0) == Box(32, 0, 40, 15)


def test_an_empty_mask_has_no_box():
    assert mask_box(np.zeros((4, 4), bool), 0.1) is None


def test_a_box_within_another_indexes_the_same_pixels():
    picture = np.arange(20 * 30).reshape(20, 30)
    inner, outer = Box(8, 6, 12, 9), Box(5, 2, 20, 18)
    assert (picture[outer.slices][inner.relative_to(outer).slices] == picture[inner.slices]).all()
