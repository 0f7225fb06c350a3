"""Every layout, written as its tool writes it, gives the cameras and pictures that it was made from."""

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import Exif
from inpaint3d.scene.image_io import read_header, read_image, write_mask, write_png
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.capture_ingest.carry import carry, fit_mask, read_exif
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame
from inpaint3d.stages.capture_ingest.layouts import detect, find

SCENE = synthetic_scene(views=4, width=32, height=24, points=20)


def pictures(folder: Path, names=SCENE.names, images=SCENE.images) -> None:
    for name, image in zip(names, images, strict=True):
        write_png(folder / f"{name}.png", image)


def found_in(folder: Path, tmp_path: Path, **options) -> Found:
    return find(folder, Config(**options), tmp_path / "work")


def assert_cameras(found: Found) -> None:
    assert [f.name for f in found.frames] == SCENE.names
    for frame, camera in zip(found.frames, SCENE.cameras, strict=True):
        np.testing.assert_allclose(frame.camera.world_from_cam, camera.world_from_cam, atol=1e-9)
        focal = frame.camera.params[0]
        assert focal == pytest.approx(camera.fx)


def test_photos_with_masks_and_truth(tmp_path):
    pictures(tmp_path / "images")
    pictures(tmp_path / "truth", ["t1", "t2"], SCENE.empty_images[:2])
    write_mask(tmp_path / "masks" / "view_001.png", SCENE.object_masks[1])
    found = found_in(tmp_path, tmp_path)
    assert detect(tmp_path) == ["photos"]
    assert [f.name for f in found.frames] == SCENE.names
    assert [f.mask is not None for f in found.frames] == [False, True, False, False]
    assert [f.name for f in found.truth] == ["t1", "t2"]
    assert found.ordered


def test_nerfstudio(tmp_path):
    pictures(tmp_path / "images")
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [
        {
            "file_path": f"images/{n}.png",
            "transform_matrix": (np.vstack([c.world_from_cam, [0, 0, 0, 1]]) @ flip).tolist(),
        }
        for n, c in zip(SCENE.names, SCENE.cameras, strict=True)
    ]
    frames.append({"file_path": "images/gone.png", "transform_matrix": np.eye(4).tolist()})
    camera = SCENE.cameras[0]
    # The file speaks of pictures twice as large.
    intrinsics = {"w": 64, "h": 48, "fl_x": 2 * camera.fx, "fl_y": 2 * camera.fy, "cx": 32, "cy": 24, "k1": 0.01}
    (tmp_path / "transforms.json").write_text(json.dumps({**intrinsics, "frames": frames}))
    found = found_in(tmp_path, tmp_path)
    assert_cameras(found)
    assert found.frames[0].camera.model == "OPENCV"
    assert found.frames[0].camera.params[4] == 0.01
    assert "5 frames, 1 of them" in found.notes[1]


def llff_rows(cameras) -> np.ndarray:
    rows = []
    for camera in cameras:
        r, d, f = camera.world_from_cam[:, 0], camera.world_from_cam[:, 1], camera.world_from_cam[:, 2]
        # LLFF speaks of the photographs at four times the size.
        columns = [d, r, -f, camera.centre, [4 * camera.height, 4 * camera.width, 4 * camera.fx]]
        rows.append([*np.stack(columns, 1).ravel(), 0.1, 10.0])
    return np.array(rows)


def test_llff(tmp_path):
    pictures(tmp_path / "images")
    np.save(tmp_path / "poses_bounds.npy", llff_rows(SCENE.cameras))
    assert detect(tmp_path) == ["llff"]
    assert_cameras(found_in(tmp_path, tmp_path))
    np.save(tmp_path / "poses_bounds.npy", llff_rows(SCENE.cameras)[:3])
    with pytest.raises(BadInputError, match="3 cameras for 4 pictures"):
        found_in(tmp_path, tmp_path)


def test_spin_nerf(tmp_path):
    pictures(tmp_path / "images_4", ["a0", "a1"], SCENE.empty_images[:2])
    pictures(tmp_path / "images_4", SCENE.names)
    for name, mask in zip(SCENE.names, SCENE.object_masks, strict=True):
        write_mask(tmp_path / "images_4" / "label" / f"{name}.png", mask)
    write_mask(tmp_path / "images_4" / "test_label" / "a0.png", SCENE.object_masks[0])
    np.save(tmp_path / "poses_bounds.npy", llff_rows([*SCENE.cameras[:2], *SCENE.cameras]))
    found = found_in(tmp_path, tmp_path, spin_nerf_truth=2)
    assert found.layout == "spin-nerf"
    assert_cameras(found)
    assert all(f.mask is not None for f in found.frames)
    assert [f.name for f in found.truth] == ["a0", "a1"]
    assert [f.mask is not None for f in found.truth] == [True, False]
    for frame, camera in zip(found.truth, SCENE.cameras, strict=False):
        np.testing.assert_allclose(frame.camera.world_from_cam, camera.world_from_cam, atol=1e-9)
    with pytest.raises(BadInputError, match="spin_nerf_truth"):
        found_in(tmp_path, tmp_path)


def test_realestate10k(tmp_path):
    """A clip as its file has it, its frames of another size than the one they are brought to."""
    root, rows = tmp_path / "raw", []
    for i, camera in enumerate(SCENE.cameras):
        shares = (camera.fx / 32, camera.fy / 24, camera.cx / 32, camera.cy / 24)
        rows.append(" ".join(map(repr, [1000 * i, *map(float, [*shares, 0, 0, *camera.cam_from_world.ravel()])])))
    pictures(root / "clip", [str(1000 * i) for i in range(4)])
    (root / "clip.txt").write_text("\n".join(["https://video/x", *rows]))
    assert detect(root) == ["realestate10k"]
    found = found_in(root, tmp_path, realestate10k_frames=3, realestate10k_rows=18)
    assert [f.name for f in found.frames] == ["0", "1000", "2000"]
    assert "first 3 frames, 1 more" in found.notes[1]
    for frame, camera in zip(found.frames, SCENE.cameras, strict=False):
        assert read_header(frame.image).upright_size == (24, 18)
        assert frame.camera.params == pytest.approx((camera.fx * 0.75, camera.fy * 0.75, 12, 9))
        np.testing.assert_allclose(frame.camera.world_from_cam, camera.world_from_cam, atol=1e-9)
    pictures(root / "other", ["0"], SCENE.images[:1])
    (root / "other.txt").write_text("https://video/y\n" + rows[0])
    with pytest.raises(BadInputError, match=r"2 clips with frames .*there are clip, other.*realestate10k_clip"):
        found_in(root, tmp_path)
    assert len(found_in(root, tmp_path, realestate10k_clip="clip").frames) == 4
    with pytest.raises(BadInputError, match="no clip gone"):
        found_in(root, tmp_path, realestate10k_clip="gone")


def test_the_first_forty_files_of_spin_nerf_are_the_truth(tmp_path):
    names = [f"IMG_{i:03d}" for i in range(44)]
    pictures(tmp_path / "images_4", names, [SCENE.images[0]] * 44)
    for name in names:  # what the files are called by their suffix does not matter
        (tmp_path / "images_4" / f"{name}.png").rename(tmp_path / "images_4" / f"{name}.JPG")
    (tmp_path / "images_4" / "label").mkdir()
    np.save(tmp_path / "poses_bounds.npy", llff_rows(SCENE.cameras * 11))
    found = found_in(tmp_path, tmp_path)
    assert [f.name for f in found.truth] == names[:40]
    assert [f.name for f in found.frames] == names[40:]


def colmap_pose(camera) -> tuple[list[float], list[float]]:
    rotation = camera.rotation.T
    w = np.sqrt(1 + np.trace(rotation)) / 2
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    return [w, *(axis / (4 * w))], list(-rotation @ camera.centre)


@pytest.mark.parametrize("binary", [False, True])
def test_colmap(tmp_path, binary):
    pictures(tmp_path / "images")
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    f = SCENE.cameras[0].fx
    poses = [colmap_pose(c) for c in SCENE.cameras]
    if binary:
        (model / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 7, 2, 32, 24, f, 16, 12, 0.05))
        body = struct.pack("<Q", 4)
        for i, (name, (q, t)) in enumerate(zip(SCENE.names, poses, strict=True)):
            body += struct.pack("<i7di", i, *q, *t, 7) + f"{name}.png".encode() + b"\0"
            body += struct.pack("<Qddq", 1, 1.0, 2.0, -1)
        (model / "images.bin").write_bytes(body)
    else:
        (model / "cameras.txt").write_text(f"# comment\n7 SIMPLE_RADIAL 32 24 {f!r} 16 12 0.05\n")
        rows = ["# comment"]
        for i, (name, (q, t)) in enumerate(zip(SCENE.names, poses, strict=True)):
            rows += [
                " ".join(map(repr, map(float, [*q, *t]))).join([f"{i} ", f" 7 {name}.png"]),
                "" if i == 0 else "1 2 -1",
            ]
        (model / "images.txt").write_text("\n".join(rows) + "\n")
    found = found_in(tmp_path, tmp_path)
    assert found.layout == "colmap"
    assert_cameras(found)
    assert found.frames[0].camera.params == (f, 16, 12, 0.05)


def test_mask_of_half_the_size_is_resampled_and_another_aspect_refused(tmp_path):
    write_mask(tmp_path / "m.png", SCENE.object_masks[0])
    write_png(tmp_path / "p.png", np.zeros((48, 64, 3), np.uint8))
    write_png(tmp_path / "square.png", np.zeros((32, 32, 3), np.uint8))
    assert fit_mask(tmp_path / "m.png", read_header(tmp_path / "p.png")).mean() == pytest.approx(
        SCENE.object_masks[0].mean()
    )
    with pytest.raises(BadInputError, match=r"m\.png is for 32x24 but the picture is 32x32"):
        fit_mask(tmp_path / "m.png", read_header(tmp_path / "square.png"))


def test_mask_without_a_picture_and_twin_names(tmp_path):
    pictures(tmp_path / "images")
    write_mask(tmp_path / "masks" / "nobody.png", SCENE.object_masks[0])
    with pytest.raises(BadInputError, match=r"nobody\.png has no picture"):
        found_in(tmp_path, tmp_path)
    (tmp_path / "images" / "view_000.jpg").write_bytes(b"x")
    with pytest.raises(BadInputError, match="same name"):
        found_in(tmp_path, tmp_path)


def test_exif_focal_is_in_pixels(tmp_path):
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(60, 40, 3, "uint8")
    for name, value in (("Exif:FocalLengthIn35mmFilm", 24), ("ExposureTime", 0.02), ("FNumber", 1.8), ("Make", "M")):
        spec.attribute(name, value)
    out = oiio.ImageOutput.create(str(tmp_path / "a.jpg"))
    out.open(str(tmp_path / "a.jpg"), spec)
    out.write_image(np.zeros((40, 60, 3), np.uint8))
    out.close()
    exif = read_exif(read_header(tmp_path / "a.jpg"), 60, 40)
    assert exif.focal_px == pytest.approx(40.0)
    assert exif.exposure_s == pytest.approx(0.02, rel=1e-3)  # EXIF keeps a ratio of integers
    assert exif.camera == "M"


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 0.0, 1e-30, 1e30])
def test_what_no_camera_records_is_not_recorded(tmp_path, value):
    """The square of an aperture of 1e-200 is 0, and an exposure is divided by it."""
    write_png(tmp_path / "a.png", np.zeros((4, 4, 3)))
    names = ("Exif:FocalLengthIn35mmFilm", "ExposureTime", "Exif:ISOSpeedRatings", "FNumber")
    header = replace(read_header(tmp_path / "a.png"), exif=dict.fromkeys(names, value))
    assert read_exif(header, 60, 40) == Exif()


@pytest.mark.parametrize(("altitude", "told"), [(431.5, 431.5), (np.nan, 0.0), (np.inf, 0.0), (-np.inf, 0.0)])
def test_a_height_that_is_none_is_not_told(tmp_path, altitude, told):
    write_png(tmp_path / "a.png", np.zeros((4, 4, 3)))
    place = {"GPS:Latitude": (47.0, 30.0, 0.0), "GPS:Longitude": (8.0, 15.0, 0.0), "GPS:Altitude": altitude}
    header = replace(read_header(tmp_path / "a.png"), exif=place)
    assert read_exif(header, 60, 40).position == (47.5, 8.25, told)


@pytest.mark.parametrize(
    ("attributes", "position"),
    [
        ({"LatitudeRef": "N", "LongitudeRef": "E", "Altitude": 431.5}, (47.5025, 8.25, 431.5)),
        ({"LatitudeRef": "S", "LongitudeRef": "W"}, (-47.5025, -8.25, 0.0)),
        ({"LatitudeRef": "N", "LongitudeRef": "E", "Latitude": (0.0, 0.0, 0.0), "Longitude": (0.0, 0.0, 0.0)}, None),
        (None, None),
    ],
)
def test_a_place_by_gps(tmp_path, attributes, position):
    """Cameras without reception write zeros."""
    import OpenImageIO as oiio  # noqa: N813

    spec = oiio.ImageSpec(60, 40, 3, "uint8")
    angles = {"Latitude": (47.0, 30.0, 9.0), "Longitude": (8.0, 15.0, 0.0)}
    for name, value in ({**angles, **attributes} if attributes else {}).items():
        kind = oiio.TypeDesc("float[3]") if isinstance(value, tuple) else None
        spec.attribute(f"GPS:{name}", *((kind, value) if kind else (value,)))
    out = oiio.ImageOutput.create(str(tmp_path / "a.jpg"))
    out.open(str(tmp_path / "a.jpg"), spec)
    out.write_image(np.zeros((40, 60, 3), np.uint8))
    out.close()
    found = read_exif(read_header(tmp_path / "a.jpg"), 60, 40).position
    assert (position is None and found is None) or found == pytest.approx(position, abs=1e-4)


def test_any_depth_and_any_way_up_become_upright_eight_bit_frames_of_their_own_size(tmp_path):
    import OpenImageIO as oiio  # noqa: N813

    picture = np.full((16, 32, 3), 0.2, np.float32)
    picture[:8, :16] = 0.8  # light at the stored top left

    def stored(name, pixel, **attributes):
        spec = oiio.ImageSpec(32, 16, 3, pixel)
        for key, value in attributes.items():
            spec.attribute(key, value)
        out = oiio.ImageOutput.create(str(tmp_path / name))
        assert out.open(str(tmp_path / name), spec)
        assert out.write_image(picture)
        out.close()
        return FoundFrame(Path(name).stem, tmp_path / name)

    found = [
        stored("plain.jpg", "uint8"), stored("turned.jpg", "uint8", Orientation=6), stored("deep.tif", "uint16"),
        stored("light.exr", "float"),
    ]  # fmt: skip
    plain, turned, deep, light = (carry(f, tmp_path / "out").frame for f in found)
    assert [f.path for f in (plain, turned, deep, light)] == [
        "frames/plain.jpg", "frames/turned.png", "frames/deep.png", "frames/light.png",
    ]  # fmt: skip
    assert (tmp_path / "out" / plain.path).read_bytes() == (tmp_path / "plain.jpg").read_bytes()
    assert [(f.width, f.height) for f in (plain, turned, deep, light)] == [(32, 16), (16, 32), (32, 16), (32, 16)]
    header = read_header(tmp_path / "out" / turned.path)
    assert (header.width, header.height, header.orientation) == (16, 32, 1)
    upright = read_image(tmp_path / "out" / turned.path)
    assert upright[0, -1, 0] > 0.7 > 0.3 > upright[0, 0, 0]
    for frame in (deep, light):
        assert read_header(tmp_path / "out" / frame.path).bits == 8
    np.testing.assert_allclose(read_image(tmp_path / "out" / deep.path)[0, 0], 0.8, atol=1 / 255)
    # Float files hold linear light: 0.8 is 0.906 once sRGB-encoded.
    np.testing.assert_allclose(read_image(tmp_path / "out" / light.path)[0, 0], 0.906, atol=1 / 255)
