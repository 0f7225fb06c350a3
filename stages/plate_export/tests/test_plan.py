"""Pieces that are evened out: where they meet, and where they are two things."""

import numpy as np

from inpaint3d.stages.plate_export.lens import Box
from inpaint3d.stages.plate_export.plan import Grid, bend_between, even_out

SIDE = 48
HOLE = np.zeros((SIDE, SIDE), bool)
HOLE[8:40, 8:40] = True
GRID = Grid(Box(0, 0, SIDE, SIDE), 1, np.zeros((SIDE, SIDE, 2)), HOLE, ~HOLE, np.zeros((SIDE, SIDE), np.uint16))
GREY = np.full((SIDE, SIDE, 3), 0.5, np.float32)
LEFT = np.arange(SIDE)[None].repeat(SIDE, 0) < SIDE // 2


def test_a_seam_that_is_joined_in_part_leaves_nothing_over() -> None:
    """Whatever cells are sure, what is added on one side is taken on the other: a rest would glow far around."""
    rng = np.random.default_rng(0)
    step, sure = rng.standard_normal((20, 20, 3)).astype(np.float32), rng.random((20, 20)) > 0.5
    one = np.indices((20, 20)).sum(0) < 20
    bend = np.zeros((20, 20, 3), np.float32)
    bend_between(bend, step, sure, one, ~one)
    assert np.abs(bend).max() > 0.1
    np.testing.assert_allclose(bend.sum((0, 1)), 0, atol=1e-5)
    assert not bend[~sure].any()


def test_a_piece_takes_the_photos_light_only_from_edges_that_both_show() -> None:
    """Too dark by 0.1, and beyond the hole's right half it shows nothing: there it stays as it is."""
    labels = np.where(HOLE, 0, -1)
    (change,) = even_out(GRID, GREY, labels, [GREY - np.float32(0.1)], [LEFT | HOLE])
    assert np.abs(change[12:36, 9] - 0.1).max() < 0.02
    assert np.abs(change[12:36, 38]).max() < 0.02


def test_two_pieces_of_different_light_meet_without_a_step() -> None:
    """The left is too bright by 0.05 and the right too dark by as much; both show the photo's edge."""
    labels = np.where(HOLE, np.where(LEFT, 0, 1), -1)
    colours = [GREY + np.float32(0.05), GREY - np.float32(0.05)]
    everywhere = np.ones_like(HOLE)
    changes = even_out(GRID, GREY, labels, colours, [everywhere, everywhere])
    made = np.where(LEFT[..., None], colours[0] + changes[0], colours[1] + changes[1])
    steps = np.abs(made[8:40, 24] - made[8:40, 23])
    assert steps[1:-1].max() < 0.01, "0.1 before; the first and the last lie at the hole's corners"
    assert np.abs(made[HOLE] - 0.5).max() < 0.05
