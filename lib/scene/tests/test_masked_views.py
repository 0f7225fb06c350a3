import numpy as np

from inpaint3d.scene.synthetic import SyntheticScene
from inpaint3d.scene.masked_views import MaskedView, find_unmasked


def test_points_under_a_mask_are_dropped(room: SyntheticScene) -> None:
    """The ball's points go, the room's stay, but for those that some view's mask covers by standing before them."""
    kept = find_unmasked(room.points, list(room.object_masks))
    on_ball = np.linalg.norm(room.points.xyz, axis=1) < 0.2 + 1e-3
    assert on_ball.any()
    assert not kept[on_ball].any()
    assert kept[~on_ball].mean() > 0.9


def test_without_masks_all_points_stay(room: SyntheticScene) -> None:
    assert find_unmasked(room.points, [np.zeros_like(m) for m in room.object_masks]).all()


def test_sightings_are_those_of_the_views_to_fit(room: SyntheticScene) -> None:
    shape = room.object_masks[0].shape
    views = [
        MaskedView(name, camera, np.zeros((*shape, 3), np.float32), np.zeros(shape, bool), np.ones(shape, bool))
        for name, camera in zip(room.names, room.cameras, strict=True)
    ]
    scene = Scene(tuple(views[1:]), (views[0],), room.points, tuple(room.names))
    sighted = scene.sightings("cpu")
    assert sighted is not None
    assert len(sighted) == (room.points.track_frame != 0).sum() > 0
    away = np.linalg.norm(sighted.rays.origins.numpy() - room.cameras[0].centre, axis=1)
    assert away.min() > 1e-3
    assert Scene(tuple(views[:1]), tuple(views[1:]), room.points.select(np.zeros(len(room.points), bool)),
                 tuple(room.names)).sightings("cpu") is None  # fmt: skip
