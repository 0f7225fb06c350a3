"""The scale of the world, told by what was measured in it: exact scenes at a known number of metres per unit."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, Exif
from inpaint3d.contracts.store import FolderStore
from inpaint3d.scene.cameras import Camera, look_at
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.pose_estimation.config import Config, Distance, Marker
from inpaint3d.stages.pose_estimation.model import Model
from inpaint3d.stages.pose_estimation.scale import EARTH_RADIUS_M, Sighting, find_scale, triangulate

METRES = 0.25  # of a unit of the made world
SIZE = (320, 240)
CAMERAS = [
    Camera(280.0, 280.0, 160.0, 120.0, *SIZE, look_at(np.array([2 * np.cos(a), 2 * np.sin(a), 1.5]), (0.0, 0.0, 0.0)))
    for a in np.linspace(0, 2.5, 6)
]
LENS = pycolmap.Camera(model="PINHOLE", width=SIZE[0], height=SIZE[1], params=[280.0, 280.0, 160.0, 120.0])
MODEL = Model(
    names=[f"{i}" for i in range(6)], lenses={1: LENS}, view_lens=[1] * 6,
    world_from_cam=np.array([c.world_from_cam for c in CAMERAS]), xyz=np.zeros((0, 3)), error=np.zeros(0),
    track_offsets=np.zeros(1, np.int64), track_view=np.zeros(0, np.int32), track_xy=np.zeros((0, 2)),
)  # fmt: skip


@pytest.fixture
def ctx(tmp_path) -> Context:
    return Context(seed=0, device="cpu", threads=1, work=tmp_path, emit=lambda event, **values: None)


def capture(folder, frames, pictures=()):
    store = FolderStore(folder / "store")
    place = store.private_folder()
    for frame, picture in zip(frames, pictures or [np.zeros((2, 2, 3), np.uint8)] * 6, strict=True):
        write_png(place / frame.path, picture)
    return store.open(store.put(place, "capture", Capture(layout="photos", ordered=True, frames=frames)), Capture)


def frames(positions=None) -> tuple[CapturedFrame, ...]:
    return tuple(
        CapturedFrame(name=f"f_{i}", path=f"frames/f_{i}.png", width=SIZE[0], height=SIZE[1],
                      exif=Exif(position=None if positions is None else tuple(positions[i])))
        for i in range(6)
    )  # fmt: skip


def scale_of(taken, config, ctx, tmp_path, pictures=()):
    return find_scale(capture(tmp_path, taken, pictures), taken, MODEL, config, ctx)


def test_rays_meet_in_the_point_that_they_come_from():
    target = np.array([0.3, -0.2, 0.1])
    seen = [Sighting(i, tuple(CAMERAS[i].project(target)[0])) for i in (0, 3, 5)]
    point, miss = triangulate(MODEL, seen)
    np.testing.assert_allclose(point, target, atol=1e-9)
    assert miss < 1e-9


def test_nothing_tells_the_scale_of_plain_photos(ctx, tmp_path):
    assert scale_of(frames(), Config(), ctx, tmp_path) is None


def test_a_person_may_say_it(ctx, tmp_path):
    found = scale_of(frames(), Config(source_metres_per_unit=0.5), ctx, tmp_path)
    assert found is not None
    assert found.metres_per_unit == 0.5


@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_two_clicked_points_at_a_measured_distance(ctx, tmp_path, noise):
    ends, rng = np.array([[0.3, 0.1, 0.0], [-0.5, 0.2, 0.1]]), np.random.default_rng(0)

    def click(view: int, end: np.ndarray) -> tuple[float, float]:
        x, y = CAMERAS[view].project(end)[0] + noise * rng.standard_normal(2)
        return float(x), float(y)

    pixels = {f"f_{i}": (click(i, ends[0]), click(i, ends[1])) for i in (0, 2, 4)}
    metres = METRES * float(np.linalg.norm(ends[0] - ends[1]))
    found = scale_of(frames(), Config(distance=Distance(metres=metres, pixels=pixels)), ctx, tmp_path)
    assert found is not None
    assert found.metres_per_unit == pytest.approx(METRES, rel=1e-6 if noise == 0 else 0.02)
    assert (found.uncertainty > 1e-3) == (noise > 0)


def test_clicks_on_a_view_that_is_not_there_are_refused(ctx, tmp_path):
    distance = Distance(metres=1, pixels={"f_0": ((1, 1), (2, 2)), "g": ((1, 1), (2, 2))})
    with pytest.raises(BadInputError, match=r"distance\.pixels names g"):
        scale_of(frames(), Config(distance=distance), ctx, tmp_path)


@pytest.mark.parametrize("other", [0.0, 1e-9, 1e-4])
def test_views_from_one_place_tell_no_distance(ctx, tmp_path, other):
    ends = [CAMERAS[0].project(np.array(end))[0] for end in ((0.3, 0.1, 0.0), (-0.5, 0.2, 0.1))]
    beside = replace(MODEL, world_from_cam=MODEL.world_from_cam.copy())
    beside.world_from_cam[1] = MODEL.world_from_cam[0]
    beside.world_from_cam[1, 0, 3] += other
    taken = frames()
    click = ((ends[0][0], ends[0][1]), (ends[1][0], ends[1][1]))
    distance = Distance(metres=1.0, pixels={"f_0": click, "f_1": click})
    with pytest.raises(
        BadInputError, match=r"distance\.pixels of f_0, f_1: 2 views see a point along rays that spread"
    ):
        find_scale(capture(tmp_path, taken), taken, beside, Config(distance=distance), ctx)


def test_one_point_clicked_twice_tells_no_distance(ctx, tmp_path):
    clicks = [tuple(CAMERAS[view].project(np.array([0.3, 0.1, 0.0]))[0]) for view in (0, 2, 4)]
    pixels = {f"f_{view}": (click, click) for view, click in zip((0, 2, 4), clicks, strict=True)}
    distance = Distance(metres=1.0, pixels=pixels)
    with pytest.raises(BadInputError, match=r"distance\.pixels of f_0, f_2, f_4: the two points lie .* units apart"):
        scale_of(frames(), Config(distance=distance), ctx, tmp_path)


def marked(camera: Camera, dictionary: int, side: float) -> np.ndarray:
    """A sheet with a marker of this side on the ground, as a camera sees it."""
    code = cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(dictionary), 3, 200)
    sheet = np.full((400, 400), 255, np.uint8)
    sheet[100:300, 100:300] = code
    corners = side * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0.0]])
    pixels = camera.project(corners)[0] - 0.5
    flat = np.array([[0, 0], [400, 0], [400, 400], [0, 400]], np.float32) - 0.5
    warp = cv2.getPerspectiveTransform(flat, pixels.astype(np.float32))
    shown = cv2.warpPerspective(sheet, warp, SIZE, flags=cv2.INTER_AREA, borderValue=128)
    return np.repeat(shown[..., None], 3, -1)


@pytest.mark.parametrize("family", ["DICT_4X4_50", "DICT_APRILTAG_36h11"])
def test_a_marker_of_known_size(ctx, tmp_path, family):
    side = 0.8
    pictures = [marked(c, getattr(cv2.aruco, family), side) for c in CAMERAS]
    config = Config(marker=Marker(dictionary=family, side_m=METRES * side))
    found = scale_of(frames(), config, ctx, tmp_path, pictures)
    assert found is not None
    assert found.metres_per_unit == pytest.approx(METRES, rel=0.03)
    assert found.uncertainty < 0.03
    assert family in found.evidence


def test_a_marker_seen_from_one_place_is_refused(ctx, tmp_path):
    still = replace(MODEL, world_from_cam=np.stack([MODEL.world_from_cam[0]] * 6))
    taken, pictures = frames(), [marked(CAMERAS[0], cv2.aruco.DICT_4X4_50, 0.8)] * 6
    with pytest.raises(BadInputError, match=r"seen in two views that stand apart \(1 are seen\)"):
        find_scale(capture(tmp_path, taken, pictures), taken, still, Config(marker=Marker(side_m=0.1)), ctx)


def test_a_marker_that_is_not_there_is_refused(ctx, tmp_path):
    blank = [np.full((240, 320, 3), 90, np.uint8)] * 6
    with pytest.raises(BadInputError, match="no marker of DICT_4X4_50 is seen in two views that stand apart"):
        scale_of(frames(), Config(marker=Marker(side_m=0.1)), ctx, tmp_path, blank)


def positions(metres_per_unit: float, noise_m: float) -> np.ndarray:
    """The cameras' places on Earth, turned about and with noise."""
    turn, _ = cv2.Rodrigues(np.array([0.0, 0.0, 1.1]))
    metres = metres_per_unit * np.array([c.centre for c in CAMERAS]) @ turn.T
    metres += noise_m * np.random.default_rng(0).standard_normal(metres.shape)
    latitude = 47.5 + np.rad2deg(metres[:, 1] / EARTH_RADIUS_M)
    longitude = 8.2 + np.rad2deg(metres[:, 0] / (EARTH_RADIUS_M * np.cos(np.deg2rad(47.5))))
    return np.stack([latitude, longitude, 400 + metres[:, 2]], 1)


@pytest.mark.parametrize(("metres_per_unit", "noise_m", "tolerance"), [(20.0, 0.0, 1e-3), (20.0, 1.0, 0.1)])
def test_gps_positions(ctx, tmp_path, metres_per_unit, noise_m, tolerance):
    found = scale_of(frames(positions(metres_per_unit, noise_m)), Config(), ctx, tmp_path)
    assert found is not None
    assert abs(found.metres_per_unit / metres_per_unit - 1) < max(3 * found.uncertainty, tolerance)


def test_gps_tells_nothing_of_a_tabletop(ctx, tmp_path):
    assert scale_of(frames(positions(0.5, 4.0)), Config(), ctx, tmp_path) is None


def test_gps_of_three_views_is_too_little(ctx, tmp_path):
    some = tuple(f if i < 3 else replace_exif(f) for i, f in enumerate(frames(positions(20.0, 0.0))))
    assert scale_of(some, Config(), ctx, tmp_path) is None


def replace_exif(frame: CapturedFrame) -> CapturedFrame:
    return frame.model_copy(update={"exif": Exif()})
