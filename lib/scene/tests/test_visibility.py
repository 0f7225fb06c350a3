import numpy as np
import pytest

from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.morphology import grow
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.scene.visibility import enlarge_cells, pool_any, shrink_holes


@pytest.fixture(scope="module")
def room() -> SyntheticScene:
    return synthetic_scene(views=6)


def views_of(room: SyntheticScene) -> list[MaskedView]:
    return [
        MaskedView(n, c, i, m, ~m)
        for n, c, i, m in zip(room.names, room.cameras, room.images, room.object_masks, strict=True)
    ]


def seen_somewhere(room: SyntheticScene, index: int) -> np.ndarray:
    """For the masked pixels of a view, whether the room's surface behind lies outside the ball in another view."""
    y, x = np.nonzero(room.object_masks[index])
    camera = room.cameras[index]
    points = camera.unproject(np.stack([x + 0.5, y + 0.5], -1), room.empty_depths[index][y, x])
    count = np.zeros(len(points), int)
    for k, other in enumerate(room.cameras):
        if k != index:
            xy, z = other.project(points)
            inside = other.inside(xy, z)
            at = np.where(inside[:, None], xy, 0).astype(int)
            count += inside & ~room.object_masks[k][at[:, 1], at[:, 0]]
    return count >= 2


def test_a_hole_keeps_what_no_view_shows_and_loses_what_others_show(room: SyntheticScene) -> None:
    """With the room's true depth behind the ball: the wall behind it is known, the floor under it is not."""
    views = views_of(room)
    depths = {v.name: d.astype(np.float32) for v, d in zip(views, room.empty_depths, strict=True)}
    reduced = shrink_holes(views, depths, 2)
    for index in (0, 3):
        before, after = views[index].hole, reduced[index].hole
        seen = np.zeros_like(before)
        seen[before] = seen_somewhere(room, index)
        assert not (after & ~before).any()
        assert 0 < after.sum() < before.sum()
        # Away from the border of what is kept, the two agree.
        assert not (after & ~grow(grow(before & ~seen, 1), 1)).any()
        assert (after[before & ~seen]).mean() > 0.95


def test_a_floater_in_front_is_not_taken_for_a_known_surface(room: SyntheticScene) -> None:
    """Depth on the ball itself: no other view shows that surface outside its mask."""
    views = views_of(room)
    depths = {v.name: d.astype(np.float32) for v, d in zip(views, room.depths, strict=True)}
    for view, reduced in zip(views, shrink_holes(views, depths, 2), strict=True):
        assert reduced.hole.sum() > 0.9 * view.hole.sum()


def test_known_pixels_and_pictures_are_untouched(room: SyntheticScene) -> None:
    views = views_of(room)
    depths = {v.name: d.astype(np.float32)[::2, ::2] for v, d in zip(views, room.empty_depths, strict=True)}
    for view, reduced in zip(views, shrink_holes(views, depths, 2), strict=True):
        assert reduced.known is view.known
        assert reduced.image is view.image


def test_cells_are_masked_if_any_pixel_is() -> None:
    mask = np.zeros((6, 9), bool)
    mask[5, 8] = True
    small = pool_any(mask, 2, 3)
    assert small.sum() == 1
    assert small[1, 2]
    back = enlarge_cells(small, mask.shape)
    assert back[3:, 6:].all()
    assert back.sum() == 9
