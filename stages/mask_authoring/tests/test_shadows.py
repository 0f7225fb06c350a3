"""Shadows that are looked for: on a tiled plane with a soft shadow of known depth, and on one without."""

import numpy as np
import pytest
from pydantic import ValidationError

from inpaint3d.contracts.models.artifacts import MaskRequest, MaskSet
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.mask_authoring.flat_surface import PlaneGrid, Texture, slice_hull
from inpaint3d.stages.mask_authoring.illumination import cast_shadows, fit_darkening
from inpaint3d.stages.mask_authoring.shadows import find_shadows
from inpaint3d.stages.mask_authoring.views import DepthView

SIDE = 72
LAMP, SKY = 40, 0  # which of the lights; the even sky comes first
STEP = 2


def make_tiles(seed: int) -> np.ndarray:
    """Log colours [side, side, 3] of a floor of tiles of five materials, with grain."""
    rng = np.random.default_rng(seed)
    materials = np.log(rng.uniform(0.1, 0.8, (5, 3)))
    tiles = materials[rng.integers(0, 5, (SIDE // 6, SIDE // 6))].repeat(6, 0).repeat(6, 1)
    return tiles + rng.normal(0, 0.03, (SIDE, SIDE, 1))


def make_cast() -> tuple[np.ndarray, np.ndarray]:
    """Shadows of a cylinder of 10 cells across and 12 high, and its foot."""
    rows, columns = np.mgrid[:SIDE, :SIDE] - SIDE / 2
    foot = np.hypot(rows, columns) < 5
    return cast_shadows([foot] * 6, STEP), foot


def fit(seed: int, lamp: float, sky: float):
    cast, foot = make_cast()
    kept = lamp * cast[LAMP] + sky * cast[SKY]
    texture = Texture(make_tiles(seed) + np.log1p(-kept.clip(0, 0.95))[..., None], np.ones((SIDE, SIDE), bool))
    return fit_darkening(texture, ~foot, cast), kept, ~foot


@pytest.mark.parametrize("seed", range(2))
def test_the_light_that_is_kept_off_is_measured_though_the_floor_is_of_many_materials(seed):
    found, kept, seen = fit(seed, 0.35, 0.3)
    error = (found.share - kept)[seen & (kept > 0.05)]
    assert np.abs(error).mean() < 0.05
    # What is well in the shadow is found, and what is well outside is not.
    assert (found.share > 0.15)[seen & (kept > 0.25)].mean() > 0.95
    assert (found.share > 0.15)[seen & (kept < 0.05)].mean() < 0.02


@pytest.mark.parametrize("seed", range(2))
def test_a_floor_without_a_shadow_has_none(seed):
    found, _, seen = fit(seed, 0.0, 0.0)
    assert found.share[seen].max() < 0.1
    assert found.gain < 0.2 * fit(seed, 0.35, 0.3)[0].gain


def test_a_shadow_falls_away_from_its_light_as_far_as_the_object_is_high():
    cast, foot = make_cast()
    rows, columns = np.nonzero(cast[LAMP] > 0.5)
    (low, high), (left, right) = ((v.min(), v.max()) for v in (rows, columns))
    reach = np.array([columns.mean(), rows.mean()]) - SIDE / 2
    # Slices lie at heights 0 to 10: a light that falls in at tilt t shifts the last one by 10 t.
    span = max(high - low, right - left) + 1 - 10
    assert np.linalg.norm(reach) > 2
    assert span > 3
    assert (cast[:, foot] > 0.4).all(), "under the object there is never light"


def test_too_little_to_compare_tells_nothing():
    cast, _ = make_cast()
    few = np.zeros((SIDE, SIDE), bool)
    few[:4, :4] = True
    assert fit_darkening(Texture(make_tiles(0), few), few, cast) is None


FLOOR = Plane(np.array([0.0, 0.0, 1.0]), -0.2)


def look_down(count: int) -> list[Camera]:
    """Cameras all around and above the origin."""
    places = [(0.9 * np.cos(a), 0.9 * np.sin(a), 0.6) for a in np.linspace(0, 2 * np.pi, count, endpoint=False)]
    return [Camera(80, 80, 60, 45, 120, 90, look_at(np.array(p), (0.0, 0.0, -0.1))) for p in places]


def look_blind(camera: Camera) -> DepthView:
    """A view whose field has no surface."""
    return DepthView("one", camera, np.full((90, 120), np.inf), lambda: np.zeros((90, 120, 3), np.float32))


def test_the_hull_of_a_mask_that_hovers_does_not_touch_the_plane():
    cameras = look_down(8)
    views = [
        DepthView(str(i), c, np.full((90, 120), np.inf), lambda: np.zeros((90, 120, 3))) for i, c in enumerate(cameras)
    ]
    grid = PlaneGrid.around(FLOOR, np.zeros(3), 0.5, cameras, 48)

    def around(height: float) -> list[np.ndarray]:
        centre = np.array([0.0, 0.0, height])
        ball = [np.linalg.norm(c.pixel_centres() - c.project(centre)[0], axis=-1) < 7 for c in cameras]
        return slice_hull(grid, views, ball, 2)

    assert around(0.15) == []
    standing = around(-0.17)
    middle = grid.points()[standing[0]].mean(0)
    np.testing.assert_allclose(middle, [0, 0, -0.2], atol=0.02)  # a cell is 0.02 wide


def test_without_depth_no_object_is_measured():
    view = look_blind(look_down(1)[0])
    assert find_shadows([FLOOR], [view], [np.ones((90, 120), bool)]) == []


@pytest.mark.parametrize("mask", [{"kind": "outpaint"}, {"kind": "sphere"}, {"kind": "scribble", "view": "a"}])
def test_shadows_of_what_is_no_object_are_refused(mask):
    with pytest.raises(ValidationError, match="leave `shadows` out"):
        MaskRequest.model_validate({"mask": mask, "shadows": True})


def test_what_is_not_asked_for_leaves_no_trace():
    request = MaskRequest.model_validate({"mask": {"kind": "imported"}})
    assert "shadows" not in request.model_dump(mode="json")
    masks = MaskSet(kind="per-view", task="inpaint", origin="object", method="by hand", views=())
    assert "shadows" not in masks.model_dump(mode="json")
