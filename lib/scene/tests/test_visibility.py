import numpy as np
import pytest

from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.morphology import grow
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.scene.visibility import enlarge_cells, enlarge_depth, pool_any, shrink_holes


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


@pytest.mark.parametrize("shape", [(12, 16), (30, 41), (90, 121)])
def test_a_plane_stays_a_plane_when_its_depth_is_enlarged(shape: tuple[int, int]) -> None:
    def plane(height: int, width: int) -> np.ndarray:
        y, x = ((np.arange(n) + 0.5) / n for n in (height, width))
        return 1 / (1.0 + 0.3 * y[:, None] - 0.2 * x[None])

    large = enlarge_depth(plane(12, 16), shape)
    # The outermost half of a cell has nothing beyond it to go on from.
    rows, columns = (slice(n // 10, n - n // 10) for n in shape)
    np.testing.assert_allclose(large[rows, columns], plane(*shape)[rows, columns], rtol=1e-9)


def test_no_depth_lies_between_two_surfaces() -> None:
    """A slanted edge between a near and a far surface is as straight at three times the size, and has two depths."""
    y, x = np.mgrid[:20, :30]
    near = x + 0.5 < 8 + 0.5 * (y + 0.5)
    large = enlarge_depth(np.where(near, 1.0, 2.0), (60, 90))
    np.testing.assert_allclose(np.minimum(np.abs(large - 1), np.abs(large - 2)), 0, atol=1e-12)
    ends = (large < 1.5).sum(1) / 3
    np.testing.assert_allclose(ends, 8 + 0.5 * (np.arange(60) + 0.5) / 3, atol=0.5)
