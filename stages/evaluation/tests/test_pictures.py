import numpy as np

from inpaint3d.stages.evaluation.pictures import (
    GAP,
    choose_clearest_view,
    colour_depth,
    hide_hole,
    outline_hole,
    set_side_by_side,
)


def test_nearer_is_lighter_and_invalid_depth_is_grey():
    depth = np.linspace(1.0, 5.0, 200, dtype=np.float32).reshape(10, 20)
    luma = colour_depth(depth) @ np.array([0.299, 0.587, 0.114])
    assert (np.diff(luma.ravel()) <= 1e-6).all()
    depth[0, 0] = 0.0
    assert (colour_depth(depth)[0, 0] == 0.5).all()
    assert np.isfinite(colour_depth(np.zeros((3, 3), np.float32))).all()


def test_outline_leaves_pixels_away_from_the_mask_alone():
    image = np.random.default_rng(0).random((20, 30, 3), dtype=np.float32)
    mask = np.zeros((20, 30), bool)
    mask[5:9, 5:9] = True
    assert (outline_hole(image, mask)[12:] == image[12:]).all()
    assert not (hide_hole(image, mask)[mask] == image[mask]).any(-1).all()


def test_panels_are_put_in_a_row():
    panel = np.zeros((6, 8, 3), np.float32)
    assert set_side_by_side([panel] * 3).shape == (6, 8 * 3 + 2 * GAP, 3)


def test_pixels_that_are_not_finite_are_seen():
    panel = np.zeros((6, 8, 3), np.float32)
    panel[2, 3, 1] = np.nan
    assert set_side_by_side([panel])[2, 3].tolist() == [1, 0, 1]


def test_a_hole_cut_by_the_border_is_shown_only_for_want_of_better():
    inside, cut = np.zeros((10, 10), bool), np.zeros((10, 10), bool)
    inside[4:6, 4:6] = True
    cut[0:8, 0:8] = True
    assert choose_clearest_view([cut, inside]) == 1
    assert choose_clearest_view([np.zeros((10, 10), bool), cut]) == 1
