import numpy as np

from inpaint3d.stages.mask_authoring.morphology import without_specks


def test_specks_go_and_parts_stay() -> None:
    """Two parts of an object that something stands before, and cells where depth was wrong."""
    mask = np.zeros((60, 80), bool)
    mask[10:50, 5:30] = True
    mask[20:40, 40:50] = True
    parts = mask.copy()
    mask[2:4, 60:64] = mask[55, 70] = True
    np.testing.assert_array_equal(without_specks(mask, 0.02), parts)
    np.testing.assert_array_equal(without_specks(mask, 0.0), mask)
    np.testing.assert_array_equal(without_specks(mask, 0.5)[:, :35], parts[:, :35])
    assert not without_specks(mask, 0.5)[:, 35:].any()


def test_no_mask_has_no_specks() -> None:
    assert not without_specks(np.zeros((4, 5), bool), 0.02).any()
