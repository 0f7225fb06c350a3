import numpy as np
import pytest

from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.scene.windows import choose_fixed_windows, compute_window_side, draw_window, sum_boxes


def _hole(height: int = 90, width: int = 120) -> np.ndarray:
    hole = np.zeros((height, width), bool)
    hole[30:60, 50:70] = True
    return hole


def test_box_sums_count_by_hand() -> None:
    mask = np.random.default_rng(0).random((9, 13)) > 0.5
    sums = sum_boxes(mask, 4)
    assert sums.shape == (6, 10)
    assert all(sums[y, x] == mask[y : y + 4, x : x + 4].sum() for y in range(6) for x in range(10))


@pytest.mark.parametrize("span", [0.2, 0.7, 1.0])
def test_every_window_overlaps_the_hole_and_holds_known_pixels(span: float) -> None:
    hole = _hole()
    rng = np.random.default_rng(3)
    for _ in range(50):
        window = draw_window(hole, ~hole, 4, size=16, span=span, min_known=0.2, rng=rng)
        assert window is not None
        xy = window.pixels()
        assert (xy > 0).all()
        assert (xy[..., 0] < 120).all()
        assert (xy[..., 1] < 90).all()
        inside = window.sample(hole)
        assert inside.any()
        assert (~inside).mean() > 0.1


def test_window_spans_the_asked_share_of_the_short_side() -> None:
    """S1: the paper's 256 of 360 rows is 71 %; a 16 pixel prior reaches it by striding."""
    window = draw_window(_hole(), ~_hole(), 0, size=16, span=0.7, min_known=0.1, rng=np.random.default_rng(0))
    assert window is not None
    assert window.spacing * window.size >= 0.7 * 90 - 0.5
    assert compute_window_side(0.01, 16, 90, 120) == 16
    assert compute_window_side(1.0, 16, 90, 120) == 90
    # A picture smaller than the prior's square: rays lie closer than a pixel.
    assert compute_window_side(0.7, 64, 36, 48) == 36


def test_a_view_without_hole_has_no_window() -> None:
    empty = np.zeros((20, 20), bool)
    assert draw_window(empty, ~empty, 0, size=8, span=0.7, min_known=0.1, rng=np.random.default_rng(0)) is None


def test_a_view_that_is_nearly_all_hole_takes_the_window_with_most_context() -> None:
    hole = np.ones((20, 30), bool)
    hole[:, 29] = False
    for seed in range(10):
        window = draw_window(hole, ~hole, 0, size=8, span=0.5, min_known=0.5, rng=np.random.default_rng(seed))
        assert window is not None
        assert window.x == 20.0


def test_pixels_outside_the_undistorted_picture_are_not_context() -> None:
    hole = _hole()
    known = ~hole
    known[:, :50] = False
    rng = np.random.default_rng(1)
    lefts = []
    for _ in range(30):
        window = draw_window(hole, known, 0, size=16, span=0.4, min_known=0.3, rng=rng)
        assert window is not None
        lefts.append(window.x)
    assert min(lefts) > 25


def test_fixed_windows_cover_as_much_of_the_hole_as_any() -> None:
    room = synthetic_scene(views=6)
    views = [
        MaskedView(n, c, i, m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]
    windows = choose_fixed_windows(views, size=16, span=0.7, min_known=0.2)
    for index, (view, window) in enumerate(zip(views, windows, strict=True)):
        assert window is not None
        rng = np.random.default_rng(index)
        drawn = [
            draw_window(view.hole, view.known, index, size=16, span=0.7, min_known=0.2, rng=rng) for _ in range(20)
        ]
        shares = [w.sample(view.hole).mean() for w in drawn if w is not None]
        # Sampling every other pixel of a window counts a hole's border one way or the other.
        assert window.sample(view.hole).mean() >= max(shares) - 0.03
