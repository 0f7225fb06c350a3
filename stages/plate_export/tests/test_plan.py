"""Pieces that are evened out: where they meet, and where they are two things."""

import numpy as np

from inpaint3d.stages.plate_export.plan import bend_between


def test_a_seam_that_is_joined_in_part_leaves_nothing_over() -> None:
    """Whatever cells are sure, what is added on one side is taken on the other: a rest would glow far around."""
    rng = np.random.default_rng(0)
    step, sure = rng.standard_normal((20, 20, 3)).astype(np.float32), rng.random((20, 20)) > 0.5
    one = np.indices((20, 20)).sum(0) < 20
    bend = np.zeros((20, 20, 3), np.float32)
    for axis in (0, 1):
        bend_between(bend, step, sure, one, ~one, 1, axis)
    assert np.abs(bend).max() > 0.1
    np.testing.assert_allclose(bend.sum((0, 1)), 0, atol=1e-5)
    assert not bend[~sure].any()
