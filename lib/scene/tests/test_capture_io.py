from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from inpaint3d.contracts.errors import ArtifactError, BadInputError
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, PosedTruth
from inpaint3d.scene.capture_io import (
    load_points,
    load_posed,
    read_captured_image,
    read_captured_mask,
    read_captured_valid,
    write_points,
    write_view,
)
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.synthetic import synthetic_scene

SCENE = synthetic_scene(views=4, width=24, height=18, points=40)


@dataclass(frozen=True)
class Folder:
    metadata: PosedTruth | Capture
    root: Path


def test_posed_views_come_back_as_written(tmp_path):
    valid = np.ones((18, 24), bool)
    valid[0] = False
    frames = [
        write_view(tmp_path, "a", SCENE.images[0], SCENE.cameras[0], split="test", relative_exposure=1.5),
        write_view(tmp_path, "b", SCENE.images[1], SCENE.cameras[1], mask=SCENE.object_masks[1], valid=valid),
    ]
    truth = PosedTruth(frames=tuple(frames), registered_share=1, mean_reprojection_error_px=0)
    a, b = load_posed(Folder(truth, tmp_path))
    assert (a.name, a.split, a.relative_exposure, b.split) == ("a", "test", 1.5, "train")
    np.testing.assert_allclose(a.image(), SCENE.images[0], atol=0.5 / 255 + 1e-6)
    np.testing.assert_array_equal(a.camera.world_from_cam, SCENE.cameras[0].world_from_cam)
    assert a.mask() is None
    assert a.valid().all()
    np.testing.assert_array_equal(b.mask(), SCENE.object_masks[1])
    np.testing.assert_array_equal(b.valid(), valid)


def test_points_come_back_as_written(tmp_path):
    write_points(tmp_path / "points.safetensors", SCENE.points)
    back = load_points(tmp_path / "points.safetensors")
    for name in ("xyz", "rgb", "error", "track_offsets", "track_frame", "track_xy"):
        np.testing.assert_array_equal(getattr(back, name), getattr(SCENE.points, name))


def test_a_points_file_without_an_array_or_of_another_kind_is_refused(tmp_path):
    path = tmp_path / "points.safetensors"
    write_points(path, SCENE.points)
    arrays = load_file(path)
    save_file({k: v for k, v in arrays.items() if k != "rgb"}, path)
    with pytest.raises(ArtifactError, match="rgb is missing"):
        load_points(path)
    save_file(arrays | {"xyz": arrays["xyz"].astype(np.float64)}, path)
    with pytest.raises(ArtifactError, match="xyz is float64"):
        load_points(path)


def test_tracks_say_which_points_a_frame_sees():
    rows = SCENE.points.track_frame == 2
    index, xy = SCENE.points.track_point[rows], SCENE.points.track_xy[rows]
    projected, z = SCENE.cameras[2].project(SCENE.points.xyz[index])
    np.testing.assert_allclose(projected, xy, atol=1e-3)  # float32 points and pixels
    assert (z > 0).all()
    assert len(index) > 5


def test_selecting_points_keeps_their_tracks():
    points = SCENE.points
    keep = np.arange(len(points)) % 3 == 0
    fewer = points.select(keep)
    for new, old in enumerate(np.flatnonzero(keep)):
        mine = slice(*fewer.track_offsets[new : new + 2])
        theirs = slice(*points.track_offsets[old : old + 2])
        np.testing.assert_array_equal(fewer.track_xy[mine], points.track_xy[theirs])
        np.testing.assert_array_equal(fewer.track_frame[mine], points.track_frame[theirs])
    assert len(points.select(np.zeros(len(points), bool))) == 0


def test_captured_frames_and_masks_are_read(tmp_path):
    write_png(tmp_path / "frames/a.png", SCENE.images[0])
    write_mask(tmp_path / "masks/a.png", SCENE.object_masks[0])
    frame = CapturedFrame(name="a", path="frames/a.png", width=24, height=18, mask="masks/a.png")
    folder = Folder(Capture(layout="photos", ordered=True, frames=(frame,)), tmp_path)
    np.testing.assert_allclose(read_captured_image(folder, frame), SCENE.images[0], atol=0.5 / 255 + 1e-6)
    np.testing.assert_array_equal(read_captured_mask(folder, frame), SCENE.object_masks[0])
    assert read_captured_mask(folder, frame.model_copy(update={"mask": None})) is None
    with pytest.raises(BadInputError, match="its image is 48x18"):
        read_captured_mask(folder, frame.model_copy(update={"width": 48}))


def test_what_is_transparent_in_a_captured_frame_is_not_valid(tmp_path):
    alpha = np.full((18, 24, 1), 255, np.uint8)
    alpha[:, :5] = 0
    codes = (255 * SCENE.images[0]).astype(np.uint8)
    write_png(tmp_path / "frames/a.png", np.concatenate([codes, alpha], -1))
    write_png(tmp_path / "frames/b.png", codes)
    a, b = (CapturedFrame(name=n, path=f"frames/{n}.png", width=24, height=18) for n in "ab")
    folder = Folder(Capture(layout="photos", ordered=True, frames=(a, b)), tmp_path)
    np.testing.assert_array_equal(read_captured_valid(folder, a), alpha[..., 0] > 0)
    assert read_captured_valid(folder, b) is None


def test_a_capture_with_one_name_for_two_frames_is_refused():
    frame = CapturedFrame(name="a", path="frames/a.png", width=24, height=18)
    with pytest.raises(ValueError, match="1 names are of several frames: a"):
        Capture(layout="photos", ordered=True, frames=(frame, frame))
