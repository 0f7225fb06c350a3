"""A plane as seen from above: where things lie on it, which lines it has, and a carpet whose borders go on."""

import cv2
import numpy as np
import pytest

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.view_completion.config import PhotoCompletion
from inpaint3d.stages.view_completion.drafts import Draft, span_unsure, start_draft
from inpaint3d.stages.view_completion.gaps import fill_gaps
from inpaint3d.stages.view_completion.rectified import (
    RectifiedPlane,
    find_line_angle,
    measure_lines_crossed,
    resample,
)
from inpaint3d.stages.view_completion.surfaces import FlatScene

SIZE = (160, 120)
FLOOR = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
TURN = 0.35
"""How far the carpet is turned against the camera's right, radians."""


@pytest.fixture(scope="module")
def camera() -> Camera:
    """Two units above the floor and as far behind the middle, looking down at it by 45 degrees."""
    down = np.sqrt(0.5)
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, -down, down], [0.0, -down, -down]])
    width, height = SIZE
    pose = np.concatenate([rotation, np.array([[0.0], [-2.0], [2.0]])], 1)
    return Camera(150.0, 150.0, width / 2, height / 2, width, height, pose)


def paint_carpet(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Its picture [h, w, 3], where its dark border is [h, w], and where its field; nine rays a pixel."""
    fine = camera.resize_to(3 * camera.width, 3 * camera.height)
    return tuple(cv2.resize(part.astype(np.float32), SIZE, interpolation=cv2.INTER_AREA) for part in _paint(fine))


def _paint(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    pixels = camera.pixel_centres().reshape(-1, 2)
    points = camera.unproject(pixels, FLOOR.depth(camera, pixels)).reshape(camera.height, camera.width, 3)
    along = points[..., 0] * np.cos(TURN) + points[..., 1] * np.sin(TURN)
    across = points[..., 1] * np.cos(TURN) - points[..., 0] * np.sin(TURN)
    out = np.maximum(np.abs(along), np.abs(across))
    field, border = out < 0.7, (out >= 0.7) & (out < 0.85)
    spots = (np.sin(31 * along) * np.sin(27 * across) > 0.3)[..., None]
    colours = np.where(spots, (0.8, 0.6, 0.3), (0.7, 0.15, 0.1))
    colours = np.where(field[..., None], colours, np.where(border[..., None], (0.1, 0.1, 0.25), (0.6, 0.55, 0.5)))
    return colours.astype(np.float32), border, field


def draft_of(camera: Camera, picture: np.ndarray, hole: np.ndarray) -> Draft:
    pixels = camera.pixel_centres().reshape(-1, 2)
    depth = FLOOR.depth(camera, pixels).reshape(hole.shape).astype(np.float32)
    view = MaskedView("view", camera, np.where(hole[..., None], 0, picture).astype(np.float32), hole, ~hole)
    draft = start_draft(0, view, depth, view.image, FlatScene([FLOOR], 0.005))
    span_unsure(draft)
    return draft


def test_places_on_the_plane_are_found_from_pixels_and_back(camera: Camera) -> None:
    where = np.ones(SIZE[::-1], bool)
    rectified = RectifiedPlane.around(camera, FLOOR, where, where, 0.2)
    xy, inside = rectified.find_pixels()
    row, column = (index[::97] for index in np.nonzero(inside))
    cells = rectified.find_cells(xy[row, column])
    np.testing.assert_allclose(cells, np.stack([column, row], -1) + 0.5, atol=1e-6)
    centres = camera.pixel_centres()[where]
    corners = rectified.find_cells(centres)
    assert (corners >= -1e-6).all()
    assert (corners <= np.array(rectified.shape[::-1])).all(), "all that was to be shown lies on the grid"


def test_the_grid_is_turned_along_the_lines(camera: Camera) -> None:
    picture, _, _ = paint_carpet(camera)
    where = np.ones(SIZE[::-1], bool)
    rectified = RectifiedPlane.around(camera, FLOOR, where, where)
    xy, inside = rectified.find_pixels()
    angle = find_line_angle(resample(picture, xy), inside)
    axes = RectifiedPlane.around(camera, FLOOR, where, where, angle).axes
    carpet = np.array([np.cos(TURN), np.sin(TURN), 0.0])
    assert max(abs(axes @ carpet)) > np.cos(np.radians(1.5))


def test_lines_are_counted_by_their_contrast_and_a_pattern_is_none() -> None:
    rng = np.random.default_rng(0)
    picture = np.full((80, 100, 3), 0.5, np.float32) + rng.normal(0, 0.05, (80, 100, 1)).astype(np.float32)
    picture[:, 60:] += 0.3
    valid = np.ones((80, 100), bool)
    valid[50:, 40:80] = False
    crossed = measure_lines_crossed(picture, valid)
    assert abs(crossed[:, 55] - crossed[:, 5]).max() == 0
    assert abs(crossed[70] - crossed[5]).max() == 0, "no line along rows"
    assert 0.1 < (crossed[:, 65] - crossed[:, 55])[:, 0].min() <= 0.31, "also where nothing is known"


def test_a_carpet_s_border_goes_on_and_none_is_copied_into_its_field(camera: Camera) -> None:
    """The gap takes a part of the border and of the field away: nine tenths of what was border are so again, and less
    than a hundredth of the field is."""
    picture, border, field = paint_carpet(camera)
    border, field = border > 0.99, field > 0.99
    hole = np.zeros(SIZE[::-1], np.uint8)
    middle = camera.project(0.64 * np.array([np.cos(TURN), np.sin(TURN), 0.0]))[0]
    cv2.circle(hole, tuple(map(int, middle)), 14, 1, -1)
    gap = hole > 0
    assert (gap & border).sum() > 50
    assert (gap & field).sum() > 200
    draft = draft_of(camera, picture, gap)
    fill_gaps(draft, PhotoCompletion(), 0, "cpu")
    assert not draft.missing.any()
    dark = draft.picture.mean(-1) < 0.25
    assert (dark & gap & border).sum() > 0.9 * (gap & border).sum()
    assert (dark & gap & field).sum() < 0.02 * (gap & field).sum()


def test_copies_on_a_plane_are_noted_where_they_come_from(camera: Camera) -> None:
    """Under one light a copy looks like the pixel it came from, to what resampling makes of it."""
    picture, _, _ = paint_carpet(camera)
    hole = np.zeros(SIZE[::-1], bool)
    hole[50:66, 70:90] = True
    draft = draft_of(camera, picture, hole)
    fill_gaps(draft, PhotoCompletion(), 0, "cpu")
    assert draft.copies is not None
    assert ((draft.copies[..., 0] >= 0) == hole).all()
    there = np.round(draft.copies[hole]).astype(int)
    assert not hole[there[:, 1], there[:, 0]].any()
    apart = np.abs(draft.picture[hole] - picture[there[:, 1], there[:, 0]]).mean()
    assert apart < 0.5 * np.abs(draft.picture[hole] - picture[hole][::-1]).mean()
