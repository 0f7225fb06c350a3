"""The whole stage on the synthetic room: known cameras, estimated ones, and captures that cannot work."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import (
    Capture,
    CapturedFrame,
    Exif,
    KnownCamera,
    PosedCapture,
    PosedTruth,
    Truth,
)
from inpaint3d.contracts.store import FolderStore, Record, Store
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.scene.geometry import Similarity
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.reprojection import warp_image
from inpaint3d.scene.synthetic import SyntheticScene, arc_cameras, synthetic_scene

MODULE = "inpaint3d.stages.pose_estimation"
SIZE = (160, 120)


class Events:
    def __init__(self) -> None:
        self.lines: list[str] = []

    def write(self, line: str) -> None:
        self.lines.append(line)

    def flush(self) -> None:
        pass


def known(camera: Camera) -> KnownCamera:
    params = (camera.fx, camera.fy, camera.cx, camera.cy)
    return KnownCamera(model="PINHOLE", params=params, world_from_cam=camera.pose)


def put(
    store: Store,
    scene: SyntheticScene,
    *,
    cameras: bool,
    truth: bool = False,
    masks: bool = False,
    others: Sequence[Camera] = (),
    **exif: float,
) -> str:
    folder = store.private_folder()
    frames = []
    for i, (name, camera) in enumerate(zip(scene.names, scene.cameras, strict=True)):
        write_png(folder / f"frames/{name}.png", (scene.empty_images if truth else scene.images)[i])
        if masks:
            write_mask(folder / f"masks/{name}.png", scene.object_masks[i])
        frames.append(
            CapturedFrame(
                name=name, path=f"frames/{name}.png", width=camera.width, height=camera.height,
                camera=known(camera) if cameras else None, mask=f"masks/{name}.png" if masks else None,
                exif=Exif(**exif), other_pose=others[i].pose if others else None,
            )
        )  # fmt: skip
    if truth:
        return store.put(folder, "truth", Truth(frames=tuple(frames)))
    return store.put(folder, "capture", Capture(layout="photos", ordered=True, frames=tuple(frames)))


def solve(store: Store, inputs: dict[str, str], **parameters: object) -> Record:
    return execute(MODULE, store, Invocation(inputs=inputs, parameters=parameters, threads=1), Events())  # pyright: ignore


def fit_similarity(source: list[np.ndarray], target: list[np.ndarray]) -> Similarity:
    """Least squares over points [n, 3] (Umeyama, PAMI 1991, eqs. 40-42)."""
    mean_s, mean_t = np.mean(source, 0), np.mean(target, 0)
    u, singular, vt = np.linalg.svd((target - mean_t).T @ (source - mean_s))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u @ np.diag(sign) @ vt
    scale = float(np.sum(singular * sign) / np.sum((source - mean_s) ** 2))
    return Similarity(scale, rotation, mean_t - scale * rotation @ mean_s)


@pytest.fixture(scope="module")
def scene() -> SyntheticScene:
    return synthetic_scene(8, *SIZE)


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    return FolderStore(tmp_path_factory.mktemp("store"))


@pytest.fixture(scope="module")
def passed_through(store: Store, scene: SyntheticScene) -> Record:
    truth = synthetic_scene(2, *SIZE, arc_deg=40)
    inputs = {
        "capture": put(store, scene, cameras=True, masks=True, exposure_s=0.01, iso=100, f_number=2.0),
        "truth": put(store, truth, cameras=True, truth=True),
    }
    return solve(store, inputs, output_longest_side=80)


def test_known_cameras_only_move_into_the_normalised_world(store: Store, scene: SyntheticScene, passed_through: Record):
    posed = store.open(passed_through.outputs["posed-capture"], PosedCapture)
    views = load_posed(posed)
    matrix = np.array(posed.metadata.source_from_normalised)
    for view, camera in zip(views, scene.cameras, strict=True):
        np.testing.assert_allclose(matrix[:, :3] @ view.camera.centre + matrix[:, 3], camera.centre, atol=1e-7)
        turned = matrix[:, :3] @ view.camera.rotation / posed.metadata.source_from_normalised_scale
        np.testing.assert_allclose(turned, camera.rotation, atol=1e-7)
        assert (view.camera.width, view.camera.height, view.camera.fx) == (80, 60, camera.fx / 2)
    centres = np.array([v.camera.centre for v in views])
    assert np.linalg.norm(centres, axis=1).max() == pytest.approx(1, abs=1e-5)
    # Up is the floor's normal; the cameras look at a spot 0.05 above the ball's middle.
    up = matrix[:, 2] / np.linalg.norm(matrix[:, 2])
    assert np.rad2deg(np.arccos(up[2])) < 1
    np.testing.assert_allclose(matrix[:, 3], [0, 0, 0.05], atol=1e-3)


def test_points_lie_on_the_rooms_surfaces(store: Store, scene: SyntheticScene, passed_through: Record):
    posed = store.open(passed_through.outputs["posed-capture"], PosedCapture)
    points = load_points(posed.root / "points.safetensors")
    assert len(points) == posed.metadata.registration.points > 100
    matrix = np.array(posed.metadata.source_from_normalised)
    errors = []
    for frame, view in enumerate(load_posed(posed)):
        rows = points.track_frame == frame
        index, xy = points.track_point[rows], points.track_xy[rows]
        projected, _ = view.camera.project(points.xyz[index])
        assert np.linalg.norm(projected - xy, axis=1).mean() < 0.5
        world = points.xyz[index] @ matrix[:, :3].T + matrix[:, 3]
        _, z = scene.cameras[frame].project(world)
        column, row = (2 * xy).astype(int).T
        errors.append(np.abs(scene.depths[frame][row, column] - z) / z)
    assert np.median(np.concatenate(errors)) < 0.02


def test_frames_masks_split_and_exposure(store: Store, scene: SyntheticScene, passed_through: Record):
    posed = store.open(passed_through.outputs["posed-capture"], PosedCapture)
    views = load_posed(posed)
    assert [v.split for v in views] == ["test"] + ["train"] * 7
    assert all(v.relative_exposure == pytest.approx(1) for v in views)
    for view, image, mask in zip(views, scene.images, scene.object_masks, strict=True):
        small = cv2.resize(image, (80, 60), interpolation=cv2.INTER_AREA)
        np.testing.assert_allclose(view.image(), small, atol=2 / 255)
        blocks = mask.reshape(60, 2, 80, 2)
        assert (view.mask() >= blocks.all((1, 3))).all()
        assert (view.mask() <= blocks.any((1, 3))).all()
        assert view.valid().all()


def test_truth_with_cameras_joins_the_same_world(store: Store, passed_through: Record):
    posed = store.open(passed_through.outputs["posed-capture"], PosedCapture)
    truth = load_posed(store.open(passed_through.outputs["posed-truth"], PosedTruth))
    matrix = np.array(posed.metadata.source_from_normalised)
    given = [c.centre for c in arc_cameras(2, *SIZE, arc_deg=40)]
    np.testing.assert_allclose([matrix[:, :3] @ v.camera.centre + matrix[:, 3] for v in truth], given, atol=1e-7)


def test_three_views_with_cameras_are_enough(store: Store):
    scene = synthetic_scene(3, *SIZE, arc_deg=30)
    record = solve(store, {"capture": put(store, scene, cameras=True)})
    posed = store.open(record.outputs["posed-capture"], PosedCapture).metadata
    assert (posed.registration.registered, len(posed.frames)) == (3, 3)
    assert posed.registration.agreement is not None
    assert posed.registration.agreement > 0.95
    assert posed.registration.points > 20


def rolled(scene: SyntheticScene) -> SyntheticScene:
    return replace(scene, cameras=[*scene.cameras[3:], *scene.cameras[:3]])


def test_cameras_in_the_wrong_order_are_refused(store: Store, scene: SyntheticScene):
    with pytest.raises(BadInputError, match=r"contradict its pictures: \d+% of \d+ verified matches"):
        solve(store, {"capture": put(store, rolled(scene), cameras=True)})


def test_cameras_without_names_take_the_order_that_the_pictures_support(store: Store, scene: SyntheticScene):
    """Truth views take it too: their poses are rows of the same file."""
    truth = synthetic_scene(2, *SIZE, arc_deg=40)
    inputs = {
        "capture": put(store, rolled(scene), cameras=True, others=scene.cameras),
        "truth": put(
            store, replace(truth, cameras=truth.cameras[::-1]), cameras=True, truth=True, others=truth.cameras
        ),
    }
    record = solve(store, inputs)
    posed = store.open(record.outputs["posed-capture"], PosedCapture)
    matrix = np.array(posed.metadata.source_from_normalised)
    views = load_posed(posed) + load_posed(store.open(record.outputs["posed-truth"], PosedTruth))
    for view, camera in zip(views, [*scene.cameras, *truth.cameras], strict=True):
        np.testing.assert_allclose(matrix[:, :3] @ view.camera.centre + matrix[:, 3], camera.centre, atol=1e-7)


@pytest.mark.slow
def test_cameras_are_found_from_the_pictures_and_truth_beside_them(store: Store):
    scene, truth = synthetic_scene(10, 240, 180), synthetic_scene(2, 240, 180, arc_deg=40)
    truth.names[:] = ["kept_a", "kept_b"]
    inputs = {
        "capture": put(store, scene, cameras=True),
        "truth": put(store, truth, cameras=False, truth=True),
    }
    record = solve(store, inputs, cameras="estimate")
    posed = store.open(record.outputs["posed-capture"], PosedCapture)
    assert posed.metadata.registration.source == "estimated"
    assert posed.metadata.registration.registered == 10
    assert posed.metadata.registration.mean_reprojection_error_px < 0.5
    assert posed.metadata.lens.params[0] == pytest.approx(scene.cameras[0].fx, rel=0.05)
    views = load_posed(posed)
    found = fit_similarity([v.camera.centre for v in views], [c.centre for c in scene.cameras])
    off = np.linalg.norm(found.points([v.camera.centre for v in views]) - [c.centre for c in scene.cameras], axis=1)
    assert off.max() < 0.02  # of an extent of 1.4
    kept = load_posed(store.open(record.outputs["posed-truth"], PosedTruth))
    assert [v.name for v in kept] == truth.names
    np.testing.assert_allclose(
        found.points([v.camera.centre for v in kept]), [c.centre for c in truth.cameras], atol=0.03
    )


@pytest.mark.slow
def test_unrelated_pictures_are_refused_with_figures(store: Store):
    rng = np.random.default_rng(0)
    scene = synthetic_scene(5, *SIZE)
    noise = [cv2.resize(rng.random((15, 20, 3), np.float32), SIZE, interpolation=cv2.INTER_CUBIC) for _ in range(5)]
    scene.images[:] = np.clip(noise, 0, 1)
    before = len(list(store.records()))
    with pytest.raises(BadInputError, match="0 of 5 views could be placed, 3 are needed"):
        solve(store, {"capture": put(store, scene, cameras=False)})
    assert len(list(store.records())) == before


def test_cameras_for_some_frames_only_are_refused(store: Store, scene: SyntheticScene):
    folder = store.private_folder()
    frames = []
    for i, (name, image) in enumerate(zip(scene.names, scene.images, strict=True)):
        write_png(folder / f"frames/{name}.png", image)
        camera = known(scene.cameras[i]) if i < 6 else None
        frames.append(CapturedFrame(name=name, path=f"frames/{name}.png", width=160, height=120, camera=camera))
    digest = store.put(folder, "capture", Capture(layout="photos", ordered=True, frames=tuple(frames)))
    with pytest.raises(BadInputError, match="6 of 8 frames came with a camera, view_006 did not"):
        solve(store, {"capture": digest})


def test_known_views_agree_with_each_other(scene: SyntheticScene, store: Store, passed_through: Record, tmp_path: Path):
    views = load_posed(store.open(passed_through.outputs["posed-capture"], PosedCapture))
    scale = store.open(passed_through.outputs["posed-capture"], PosedCapture).metadata.source_from_normalised_scale
    depths = [d[::2, ::2] / scale for d in scene.depths[3:5]]
    warped, seen = warp_image(views[3].image(), views[3].camera, depths[0], views[4].camera, depths[1])
    assert (
        np.abs(warped - views[4].image())[seen].mean() < 0.4 * np.abs(views[3].image() - views[4].image())[seen].mean()
    )


def moved_scene(scene: SyntheticScene, shift: np.ndarray) -> SyntheticScene:
    """The room with each camera moved by a row of `shift` [views, 3]."""
    poses = [
        np.concatenate([c.rotation, (c.centre + s)[:, None]], 1) for c, s in zip(scene.cameras, shift, strict=True)
    ]
    cameras = [replace(c, world_from_cam=p) for c, p in zip(scene.cameras, poses, strict=True)]
    return replace(scene, cameras=cameras)


def test_coordinates_of_a_survey_are_nothing_special(store: Store, scene: SyntheticScene, passed_through: Record):
    """UTM: half a million metres east, five million north. They were refused, or their rotations rounded away."""
    away = np.array([512_000.25, 5_403_000.5, 210.125])
    record = solve(
        store, {"capture": put(store, moved_scene(scene, np.tile(away, (8, 1))), cameras=True)}, output_longest_side=80
    )
    there = store.open(record.outputs["posed-capture"], PosedCapture).metadata
    here = store.open(passed_through.outputs["posed-capture"], PosedCapture).metadata
    for moved, plain in zip(there.frames, here.frames, strict=True):
        np.testing.assert_allclose(moved.world_from_cam, plain.world_from_cam, rtol=0, atol=1e-6)
    assert there.registration.points == pytest.approx(here.registration.points, rel=0.02)
    np.testing.assert_allclose(np.array(there.source_from_normalised)[:, 3], away + np.array([0, 0, 0.05]), atol=1e-2)


@pytest.mark.parametrize("times", [20.0, 1000.0])
def test_a_camera_far_away_from_all_others_is_refused_by_name(store: Store, scene: SyntheticScene, times: float):
    shift = np.zeros((8, 3))
    shift[3] = (times - 1) * scene.cameras[3].centre
    with pytest.raises(BadInputError, match=r"stand those of view_003 .\d+ times as far as most.*leave these"):
        solve(store, {"capture": put(store, moved_scene(scene, shift), cameras=True)}, output_longest_side=80)
