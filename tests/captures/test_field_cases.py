"""Captures as in public bug reports of other tools, each with its right value; photos are the demo's, made small.

What a person gives is taken in as `inpaint3d run` does, then ingested, and posed where the case is about that.
"""

import shutil
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from PIL import Image

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.kit.shim import execute
from inpaint3d.contracts.models.artifacts import Capture, PosedCapture, Truth
from inpaint3d.contracts.store import Artifact, FolderStore
from inpaint3d.orchestrator.intake import take_capture
from inpaint3d.scene.image_io import read_image, read_mask
from tests.clips import turn_clip, write_clip
from tests.colour_profiles import DISPLAY_P3, SRGB_CURVE, matrix_profile
from tests.demo_photos import (
    camera,
    lens,
    llff_row,
    names,
    object_mask,
    photo,
    write_json,
    write_model,
    write_photos,
    write_transforms,
)


class Taken(NamedTuple):
    """A capture that was taken in."""

    store: FolderStore
    capture: Artifact[Capture]
    truth: Artifact[Truth] | None
    log: str

    def picture(self, number: int) -> np.ndarray:
        return read_image(self.capture.path(self.capture.metadata.frames[number].path))

    def masks(self) -> list[np.ndarray]:
        return [read_mask(self.capture.path(f.mask)) for f in self.capture.metadata.frames if f.mask]


def take(folder: Path, root: Path, **parameters: object) -> Taken:
    store, log = FolderStore(folder / "store"), StringIO()
    inputs = {"source": take_capture(store, root)}
    made = execute("inpaint3d.stages.capture_ingest", store, Invocation(inputs=inputs, parameters=parameters), log)
    truth = store.open(made.outputs["truth"], Truth) if "truth" in made.outputs else None
    return Taken(store, store.open(made.outputs["capture"], Capture), truth, log.getvalue())


def pose(taken: Taken) -> PosedCapture:
    inputs = {"capture": taken.capture.digest}
    made = execute("inpaint3d.stages.pose_estimation", taken.store, Invocation(inputs=inputs, threads=1), StringIO())
    return taken.store.open(made.outputs["posed-capture"], PosedCapture).metadata


@pytest.fixture
def root(tmp_path: Path) -> Path:
    (tmp_path / "input").mkdir()
    return tmp_path / "input"


def plain(step: int = 5, count: int = 8, suffix: str = ".jpg", below: str = "images/") -> dict[str, str]:
    return {f"{below}{name}{suffix}": name for name in names(step, count)}


def two_cameras(below: str) -> dict[str, str]:
    sides = {"left": 0, "right": 25}
    return {f"{below}{s}/{i:04d}.jpg": n for s, at in sides.items() for i, n in enumerate(names(4, 6, at), 1)}


def test_smaller_copies_do_not_make_a_capture_spin_nerf(tmp_path, root):
    photos = plain(1, 50)
    write_photos(root, photos, 60)
    write_photos(root, plain(1, 50, below="images_4/"), 30)
    np.save(root / "poses_bounds.npy", [llff_row(name, 60) for name in photos.values()])
    write_model(root / "sparse/0", {Path(file).name: name for file, name in photos.items()}, 60)
    taken = take(tmp_path, root)
    assert (taken.capture.metadata.layout, len(taken.capture.metadata.frames), taken.truth) == ("colmap", 50, None)


def test_spin_nerf_labels_without_names_go_by_order(tmp_path, root):
    photos = {f"images_4/2022_{i:03d}.jpg": name for i, name in enumerate(names(4, 12))}
    write_photos(root, photos, 120)
    mask = np.zeros((90, 120), np.uint8)
    mask[30:55, 45:75] = 255
    for folder, labels in (
        ("test_label", [f"out_{i:05d}.png" for i in range(1, 5)]),
        ("label", [f"2022_{i:03d}.png" for i in range(4, 12)]),
    ):
        (root / "images_4" / folder).mkdir()
        for label in labels:
            Image.fromarray(mask).save(root / "images_4" / folder / label)
    np.save(root / "poses_bounds.npy", [llff_row(name, 120) for name in photos.values()])
    taken = take(tmp_path, root, spin_nerf_truth=4)
    assert [(m == (mask > 0)).all() for m in taken.masks()] == [True] * 8
    assert taken.truth is not None
    shown = [read_mask(taken.truth.path(f.mask)) for f in taken.truth.metadata.frames if f.mask]
    assert [(m == (mask > 0)).all() for m in shown] == [True] * 4


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["nerfstudio", "colmap"])
def test_two_cameras_with_the_same_names_keep_all_their_pictures(tmp_path, root, layout):
    photos = two_cameras("images/")
    write_photos(root, photos, 160)
    if layout == "nerfstudio":
        write_transforms(root, photos, 160, camera_model="OPENCV")
    else:
        write_model(root / "sparse/0", two_cameras(""), 160)
    taken = take(tmp_path, root)
    frames = taken.capture.metadata.frames
    assert len({f.name for f in frames}) == len({f.path for f in frames}) == 12
    assert len(list((taken.capture.root / "frames").iterdir())) == 12
    assert pose(taken).registration.registered == 12


@pytest.mark.slow
def test_a_fisheye_is_straightened(tmp_path, root):
    width, height = 240, 180
    (f, cx, cy, _), (big_f, big_cx, big_cy, k) = lens(width), lens(2 * width)
    x, y = np.meshgrid((np.arange(width) + 0.5 - cx) / f, (np.arange(height) + 0.5 - cy) / f)
    theta = np.hypot(x, y)
    px, py = (v * np.tan(theta) / theta for v in (x, y))  # what the pinhole sees there
    radial = 1 + k * (px**2 + py**2)
    where = [(big_f * p * radial + c - 0.5).astype(np.float32) for p, c in ((px, big_cx), (py, big_cy))]
    photos = plain(4, 12)
    (root / "images").mkdir()
    for file, name in photos.items():
        bent = cv2.remap(np.asarray(photo(name, 2 * width)), *where, cv2.INTER_AREA)
        Image.fromarray(bent).save(root / file, quality=90)
    write_transforms(root, photos, width, camera_model="OPENCV_FISHEYE", k1=0.0)
    found = pose(take(tmp_path, root)).registration
    assert found.registered == 12
    assert found.mean_reprojection_error_px < 0.4


def test_black_is_the_hole_of_mask_path(tmp_path, root):
    photos = plain(4, 10)
    write_photos(root, photos, 160)
    frames = write_transforms(root, photos, 160, camera_model="OPENCV")
    (root / "person").mkdir()
    for i, (frame, name) in enumerate(zip(frames, photos.values(), strict=True)):
        frame["mask_path"] = f"person/{i:05d}.png"
        Image.fromarray(np.where(object_mask(name, 160), 0, 255).astype(np.uint8)).save(root / frame["mask_path"])
    f, cx, cy, k = lens(160)
    write_json(
        root / "transforms.json",
        {"fl_x": f, "fl_y": f, "cx": cx, "cy": cy, "w": 160, "h": 120, "k1": k, "frames": frames},
    )
    holes = take(tmp_path, root).masks()
    assert [(hole == object_mask(n, 160)).all() for hole, n in zip(holes, photos.values(), strict=True)] == [True] * 10


@pytest.mark.parametrize("suffix", [".png", ".jpg.png"])
@pytest.mark.parametrize("inside", [1, 255])
def test_masks_of_zero_and_one_and_of_colmaps_names(tmp_path, root, suffix, inside):
    photos = plain(4, 8)
    write_photos(root, photos, 160)
    (root / "masks").mkdir()
    for name in photos.values():
        Image.fromarray(object_mask(name, 160).astype(np.uint8) * inside).save(root / "masks" / f"{name}{suffix}")
    holes = take(tmp_path, root).masks()
    assert [(hole == object_mask(n, 160)).all() for hole, n in zip(holes, photos.values(), strict=True)] == [True] * 8


@pytest.mark.slow
def test_portrait_photographs_with_a_model_of_their_stored_pixels(tmp_path, root):
    photos = plain(4, 12)
    exif = Image.Exif()
    exif[0x0112] = 6
    write_photos(root, photos, 240, exif=exif)
    write_model(root / "sparse/0", {Path(file).name: name for file, name in photos.items()}, 240)
    posed = pose(take(tmp_path, root))
    assert posed.registration.registered == 12
    assert posed.registration.mean_reprojection_error_px < 0.35
    assert (posed.lens.model, *posed.lens.params) == ("SIMPLE_RADIAL", 201, 90, 120, pytest.approx(-0.072))
    assert {(f.width, f.height) for f in posed.frames} == {(180, 240)}


def test_a_pose_that_is_not_finite_is_named_with_its_document_and_frame(tmp_path, root):
    photos = plain()
    write_photos(root, photos, 60)
    write_transforms(root, photos, 60)
    document = (root / "transforms.json").read_text()
    centre = str(float(camera("frame_015", 60).centre[0]))
    (root / "transforms.json").write_text(document.replace(centre, "NaN", 1))
    with pytest.raises(BadInputError, match=r"transforms\.json: the camera of frame_015\.jpg"):
        take(tmp_path, root)


def test_pictures_outside_are_never_read(tmp_path, root):
    outside = plain(below=f"{tmp_path}/elsewhere/")
    write_photos(root, outside, 60)
    write_transforms(root, outside, 60)
    with pytest.raises(BadInputError, match=r"elsewhere/frame_000\.jpg lies outside the capture"):
        take(tmp_path, root)
    write_photos(root, plain(below="elsewhere/"), 60)
    taken = take(tmp_path, root)
    assert len(taken.capture.metadata.frames) == 8
    assert "lists 8 files outside the capture" in taken.log


def test_blender_splits(tmp_path, root):
    f = lens(120)[0]
    for split, chosen in (("train", names(4, 8)), ("test", names(4, 3, 2)), ("val", names(4, 3, 1))):
        photos = {f"{split}/r_{i}.png": name for i, name in enumerate(chosen)}
        write_photos(root, photos, 120)
        frames = write_transforms(root, photos, 120)
        frames = [frame | {"file_path": f"./{frame['file_path'].removesuffix('.png')}"} for frame in frames]
        write_json(root / f"transforms_{split}.json", {"camera_angle_x": 2 * np.arctan(60 / f), "frames": frames})
    (root / "transforms.json").unlink()
    taken = take(tmp_path, root)
    assert taken.truth is not None
    assert (len(taken.capture.metadata.frames), len(taken.truth.metadata.frames)) == (8, 3)
    known = taken.capture.metadata.frames[0].camera
    assert known is not None
    assert known.params[0] == pytest.approx(f)


def test_a_folder_of_links_to_where_the_photographs_are_kept(tmp_path, root):
    write_photos(tmp_path / "photos", plain(below=""), 60)
    (root / "images").symlink_to("../photos")
    assert len(take(tmp_path, root).capture.metadata.frames) == 8


def test_display_p3_becomes_srgb(tmp_path, root):
    for name in names(5, 2):
        image = photo(name, 160)
        image.paste((230, 40, 40), (0, 0, 32, 32))
        profile = matrix_profile(DISPLAY_P3, SRGB_CURVE)
        image.save(root / f"{name}.jpg", quality=95, subsampling=0, icc_profile=profile)
    np.testing.assert_allclose(255 * take(tmp_path, root).picture(0)[10, 10], (251, 0, 18), atol=4)


@pytest.mark.slow
def test_two_lenses_of_one_size_are_told_apart_by_their_focal_lengths(tmp_path, root):
    for i, name in enumerate(names(2, 20)):
        tele = i % 2
        image = photo(name, 480)
        image = image.crop((96, 72, 384, 288)) if tele else image
        exif = Image.Exif()
        exif[0x010F], exif[0x0110] = "Maker", "Phone"
        exif.get_ifd(0x8769)[0xA405] = 50 if tele else 30
        image.resize((240, 180), Image.Resampling.BOX).save(root / f"IMG_{i:04d}.jpg", quality=90, exif=exif)
    posed = pose(take(tmp_path, root))
    assert posed.registration.mean_reprojection_error_px < 0.45
    wide, tele = posed.frames[0], posed.frames[1]
    assert (wide.fx, tele.fx) == (pytest.approx(201, rel=0.03), pytest.approx(335, rel=0.03))
    assert wide.cx == pytest.approx(120, abs=1)


def test_a_clip_beside_photos_is_left_aside_aloud(tmp_path, root):
    write_photos(root, {f"IMG_{i:04d}.JPG": n for i, n in enumerate(names(4, 10))}, 60, format="JPEG")
    write_clip(root / "IMG_0003.MP4", [np.asarray(photo(name, 80)) for name in names(2, 6)])
    taken = take(tmp_path, root)
    assert (taken.capture.metadata.layout, len(taken.capture.metadata.frames)) == ("photos", 10)
    assert "1 videos lie beside the pictures and are left out (IMG_0003.MP4)" in taken.log


def test_what_is_transparent_is_no_evidence(tmp_path, root):
    photos = plain(suffix=".png")
    (root / "images").mkdir()
    for file, name in photos.items():
        rgba = np.dstack([np.asarray(photo(name, 80)), np.full((60, 80), 255, np.uint8)])
        rgba[:, :20] = (255, 0, 255, 0)
        Image.fromarray(rgba).save(root / file)
    taken = take(tmp_path, root)
    assert np.ptp(taken.picture(0)[30, :21], 0).max() < 0.01  # the colour of the nearest pixel that is there
    assert "8 of 8 pictures have transparent pixels" in taken.log


@pytest.mark.slow
def test_rows_without_names_in_the_order_of_text(tmp_path, root):
    photos = {f"images/f_{i}.jpg": name for i, name in enumerate(names(3, 14))}
    write_photos(root, photos, 240)
    np.save(root / "poses_bounds.npy", [llff_row(photos[file], 240) for file in sorted(photos)])
    found = pose(take(tmp_path, root)).registration
    assert found.registered == 14
    assert found.mean_reprojection_error_px < 0.55


def test_a_folder_with_its_own_runs_is_the_same_capture(tmp_path, root):
    write_photos(root, plain(below=""), 60)
    first = take(tmp_path, root)
    (root / "runs/input/logs").mkdir(parents=True)
    write_json(root / "runs/input/metrics.json", {})
    shutil.copy(root / "frame_000.jpg", root / "runs/input/picture.jpg")
    shutil.copytree(tmp_path / "store", root / ".inpaint3d")
    assert take(tmp_path, root).capture.digest == first.capture.digest


def test_pictures_of_every_kind_in_one_folder(tmp_path, root):
    kinds = {
        "a 01 (cmyk).jpg": "CMYK", "a 03 palette.PNG": "P", "a 04 grau #1.JPEG": "L", "a 05 Größe.png": "LA",
        "a 06 50%.webp": "RGB", "a 07 фото.jpg": "RGB", "a 08.png": "RGBA", "a 09.bmp": "RGB",
    }  # fmt: skip
    for (file, mode), name in zip(kinds.items(), names(4, 8), strict=True):
        given = photo(name, 120)
        (given.quantize(256) if mode == "P" else given.convert(mode)).save(root / file)
    deep = np.asarray(photo("frame_032", 120)).astype(np.uint16) * 257
    cv2.imwrite(str(root / "a 02.TIF"), deep[..., ::-1])
    (root / "._a 07 фото.jpg").write_bytes(b"\0\5\x16\7" + bytes(60))
    (root / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
    taken = take(tmp_path, root)
    for i, frame in enumerate(taken.capture.metadata.frames):
        file = next(file for file in [*kinds, "a 02.TIF"] if Path(file).stem == frame.name)
        given = photo("frame_032", 120) if file == "a 02.TIF" else Image.open(root / file).convert("RGB")
        with Image.open(taken.capture.path(frame.path)) as written:
            assert written.mode != "CMYK", file  # inks are no sRGB
        assert np.abs(255 * taken.picture(i) - np.asarray(given)).mean() < 1, file  # decoders of JPEG round
    assert len(taken.capture.metadata.frames) == 9


@pytest.mark.parametrize("degrees", [90, 180, 270])
def test_a_clip_that_was_held_another_way_is_upright(tmp_path, root, degrees):
    write_clip(root / "walk.mp4", [np.asarray(photo(name, 160)) for name in names(4, 8)])
    upright = take(tmp_path, root)
    turn_clip(root / "walk.mp4", degrees)
    shown = take(tmp_path, root)
    assert len(shown.capture.metadata.frames) == len(upright.capture.metadata.frames)
    np.testing.assert_array_equal(shown.picture(0), np.rot90(upright.picture(0), -degrees // 90))
