from dataclasses import replace

import numpy as np
import pytest

from inpaint3d.scene.masked_views import find_unmasked
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene


@pytest.fixture(scope="module")
def room() -> SyntheticScene:
    return synthetic_scene(views=6)


def test_points_under_a_mask_are_dropped(room: SyntheticScene) -> None:
    """The ball's points go, the room's stay, but for those that some view's mask covers by standing before them."""
    kept = find_unmasked(room.points, list(room.object_masks))
    on_ball = np.linalg.norm(room.points.xyz, axis=1) < 0.2 + 1e-3
    assert on_ball.any()
    assert not kept[on_ball].any()
    assert kept[~on_ball].mean() > 0.9


def test_features_on_a_picture_s_border_are_pixels_of_it(room: SyntheticScene) -> None:
    """Undistorted, they may lie beyond it by less than a pixel; -1 is no pixel of the other side."""
    points = room.points.select(np.arange(len(room.points)) < 4)
    height, width = room.object_masks[0].shape
    corners = np.array([(-0.4, -0.4), (width, -0.4), (-0.4, height), (width + 0.4, height + 0.4)], np.float32)
    ends = np.arange(5)
    seen = replace(points, track_offsets=ends, track_frame=np.zeros(4, np.int32), track_xy=corners)
    hole = np.zeros((height, width), bool)
    hole[0, 0] = hole[-1, 0] = True
    assert find_unmasked(seen, [hole]).tolist() == [False, True, False, True]


def test_without_masks_all_points_stay(room: SyntheticScene) -> None:
    assert find_unmasked(room.points, [np.zeros_like(m) for m in room.object_masks]).all()
