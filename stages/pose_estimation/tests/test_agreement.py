"""Cameras against exact matches of the synthetic room: right ones agree, each slip is seen and, where usual, named."""

from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import CapturedFrame, KnownCamera
from inpaint3d.scene.cameras import as_pose
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.pose_estimation import known
from inpaint3d.stages.pose_estimation.agreement import Cameras, measure_agreement, measure_distances
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.matches import Kind, VerifiedPair, count_kinds
from inpaint3d.stages.pose_estimation.suspects import find_repair

VIEWS = 12
SCENE = synthetic_scene(VIEWS, 160, 120, points=300)
TOLERANCE = 0.004
FEATURES = [500] * VIEWS


def see(view: int, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    xy, z = SCENE.cameras[view].project(xyz)
    return xy, SCENE.cameras[view].inside(xy, z)


def exact_pairs(noise_px: float = 0.0) -> list[VerifiedPair]:
    rng, pairs = np.random.default_rng(0), []
    for a in range(VIEWS):
        for b in range(a + 1, min(a + 5, VIEWS)):
            (first, in_first), (second, in_second) = see(a, SCENE.points.xyz), see(b, SCENE.points.xyz)
            both = in_first & in_second
            noise = noise_px * rng.standard_normal((2, int(both.sum()), 2))
            pairs.append(VerifiedPair(a, b, first[both] + noise[0], second[both] + noise[1], Kind.CALIBRATED))
    return pairs


PAIRS = exact_pairs(noise_px=0.15)


def right() -> Cameras:
    lenses = [
        pycolmap.Camera(model="PINHOLE", width=c.width, height=c.height, params=[c.fx, c.fy, c.cx, c.cy])
        for c in SCENE.cameras
    ]
    return Cameras(lenses, [c.world_from_cam for c in SCENE.cameras])


def posed(rotation: np.ndarray, centre: np.ndarray) -> np.ndarray:
    return np.concatenate([rotation, centre[:, None]], 1)


def share(cameras: Cameras) -> float:
    return measure_agreement(PAIRS, cameras, TOLERANCE).share


def focal(factor: float) -> Cameras:
    cameras = right()
    for lens in cameras.lenses:
        lens.params = [lens.params[0] * factor, lens.params[1] * factor, *lens.params[2:]]
    return cameras


def test_right_cameras_agree_in_any_world():
    assert share(right()) > 0.98
    turn, _ = cv2.Rodrigues(np.array([0.3, -1.0, 2.0]))
    moved = [posed(turn @ p[:, :3], 7 * turn @ p[:, 3] + [3, 2, 1]) for p in right().world_from_cam]
    assert share(replace(right(), world_from_cam=moved)) == pytest.approx(share(right()), abs=1e-3)


OPENGL, MIRROR = np.diag([1.0, -1, -1]), np.diag([-1.0, 1, 1])
POSES = right().world_from_cam
TEXT = sorted(range(VIEWS), key=lambda i: f"f_{i}")
WRONG = {
    "the order of names as text": [POSES[i] for i in TEXT],
    "neighbours' poses": [POSES[(i + 1) % VIEWS] for i in range(VIEWS)],
    "mirrored poses": [posed(MIRROR @ p[:, :3] @ MIRROR, MIRROR @ p[:, 3]) for p in POSES],
    "looking backwards": [posed(p[:, :3] @ np.diag([-1.0, 1, -1]), p[:, 3]) for p in POSES],
    "OpenGL's axes": [posed(p[:, :3] @ OPENGL, p[:, 3]) for p in POSES],
    "all at one place": [posed(p[:, :3], POSES[0][:, 3]) for p in POSES],
    "inverse matrices": [posed(p[:, :3].T, -p[:, :3].T @ p[:, 3]) for p in POSES],
    "the reverse order": POSES[::-1],
}


@pytest.mark.parametrize("slip", WRONG)
def test_wrong_poses_disagree(slip):
    assert share(replace(right(), world_from_cam=WRONG[slip])) < 0.5


@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        (focal(1.3), "if focal lengths are 0.77 times as long"),
        (focal(0.7), "if focal lengths are 1.43 times as long"),
        (replace(right(), world_from_cam=WRONG["OpenGL's axes"]), "OpenGL"),
        (replace(right(), world_from_cam=WRONG["inverse matrices"]), "the wrong way round"),
        (replace(right(), world_from_cam=WRONG["the reverse order"]), "in the reverse order"),
    ],
)
def test_a_usual_slip_is_named(cameras, words):
    repair = find_repair(PAIRS, cameras, TOLERANCE)
    assert repair is not None
    assert words in repair.words
    assert repair.median_distance == pytest.approx(measure_agreement(PAIRS, right(), 0.0).median_distance, rel=0.5)


@pytest.mark.parametrize("factor", [1.3, 0.7])
def test_a_wrong_focal_length_that_hardly_shows_is_refused(factor):
    """From an arc, matches lie near their epipolar lines whatever the focal length."""
    wrong = [
        f.model_copy(update={"camera": f.camera.model_copy(update={"params": focal(factor).lenses[0].params})})
        for f in frames(POSES)
    ]
    assert share(focal(factor)) > Config().min_agreement
    with pytest.raises(BadInputError, match=r"px if focal lengths are \S+ times as long"):
        known.check(wrong, PAIRS, FEATURES, Config())


@pytest.mark.parametrize("factor", [1.0, 1.03, 0.97])
def test_where_no_slip_explains_it_none_is_named(factor):
    assert find_repair(PAIRS, focal(factor), TOLERANCE) is None
    assert find_repair(PAIRS, replace(right(), world_from_cam=WRONG["mirrored poses"]), TOLERANCE) is None


def frames(poses: list[np.ndarray], other: list[np.ndarray] | None = None) -> list[CapturedFrame]:
    made = []
    for i, camera in enumerate(SCENE.cameras):
        params = (camera.fx, camera.fy, camera.cx, camera.cy)
        given = KnownCamera(model="PINHOLE", params=params, world_from_cam=as_pose(poses[i]))
        pose = None if other is None else as_pose(other[i])
        made.append(CapturedFrame(name=f"f_{i}", path=f"frames/f_{i}.png", width=160, height=120, camera=given,
                                  other_pose=pose))  # fmt: skip
    return made


def logged(lines: list[str]) -> Context:
    return Context(seed=0, device="cpu", threads=1, work=None, emit=lambda event, **v: lines.append(v["message"]))  # pyright: ignore


@pytest.mark.parametrize("right_is_other", [False, True])
def test_rows_without_names_go_in_the_order_that_the_pictures_support(right_is_other):
    wrong, lines = WRONG["the order of names as text"], []
    given = frames(wrong, POSES) if right_is_other else frames(POSES, wrong)
    chosen, other = known.choose_order(given, PAIRS, Config(), logged(lines))
    assert other is right_is_other
    np.testing.assert_allclose([f.camera.world_from_cam for f in chosen], POSES)
    assert f"the order as {'numbers' if right_is_other else 'text'} is taken" in lines[0]


def test_named_cameras_have_one_order():
    lines = []
    assert known.choose_order(frames(POSES), PAIRS, Config(), logged(lines)) == (tuple(frames(POSES)), False)
    assert not lines


def test_a_good_capture_passes():
    known.check(frames(POSES), PAIRS, FEATURES, Config())


def test_one_turned_camera_is_named():
    turned = list(POSES)
    turned[7] = posed(POSES[7][:, :3] @ np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), POSES[7][:, 3])
    with pytest.raises(BadInputError, match=r"1 of 12 views contradict their pictures.*: f_7 .\d+% of \d+."):
        known.check(frames(turned), PAIRS, FEATURES, Config())


def test_half_the_photos_of_another_scene_are_refused():
    """Matches among them are verified, but those cameras stand elsewhere."""
    strange = POSES[:6] + WRONG["mirrored poses"][6:]
    with pytest.raises(BadInputError, match="contradict"):
        known.check(frames(strange), [p for p in PAIRS if (p.first < 6) == (p.second < 6)], FEATURES, Config())


def test_black_frames_are_named():
    with pytest.raises(BadInputError, match=r"2 pictures show nothing that could be recognised .f_1, f_4."):
        known.check(frames(POSES), PAIRS, [0 if i in (1, 4) else 500 for i in range(VIEWS)], Config())


def test_without_a_match_nothing_contradicts():
    known.check(frames(WRONG["mirrored poses"]), [], FEATURES, Config())


def test_pairs_that_tell_no_depth_are_counted():
    still = [replace(p, second_xy=p.first_xy + 0.1, kind=Kind.PLANAR_OR_PANORAMIC) for p in PAIRS[:3]]
    counts = count_kinds([*still, replace(PAIRS[3], kind=Kind.PLANAR), *PAIRS[4:]], 160)
    assert (counts.still, counts.turned, counts.planar, counts.verified) == (3, 3, 1, len(PAIRS))


def test_without_a_baseline_directions_alone_are_judged():
    """Where two cameras stand in one point every ray meets every other: no match is off, none divides by nothing."""
    cameras = right()
    poses = [cameras.world_from_cam[0]] * 2
    xy, inside = see(0, SCENE.points.xyz)
    pair = VerifiedPair(0, 1, xy[inside], xy[inside], Kind.CALIBRATED)
    assert not measure_distances(pair, Cameras(cameras.lenses, poses)).any()
