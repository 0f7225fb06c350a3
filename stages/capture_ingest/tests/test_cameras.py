"""Cameras that come with a data set: turned and scaled as their pictures, or refused by name."""

import dataclasses
import json

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import read_header, read_image, turn_upright, write_png
from inpaint3d.stages.capture_ingest import colmap, llff, nerfstudio
from inpaint3d.stages.capture_ingest.carry import carry, fit_mask
from inpaint3d.stages.capture_ingest.found import FoundFrame
from inpaint3d.stages.capture_ingest.lenses import StatedLens, fit_camera, same_aspect
from tests.data_sets import (
    SCENE,
    nerfstudio_frames,
    opengl_pose,
    write_colmap_text,
    write_llff,
    write_nerfstudio,
    write_pictures,
)

NAMES = ["a_1.png", "a_2.png", "a_3.png"]


def write_turned(path, pixels, orientation):
    """A TIFF (without loss) of stored pixels that are to be shown turned."""
    path.parent.mkdir(parents=True, exist_ok=True)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, "uint8")
    spec.attribute("Orientation", orientation)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(np.ascontiguousarray(pixels, np.float32))
    output.close()
    return path


def project(camera, points):
    """COLMAP's OPENCV or simpler (img = f * distorted + c), world points [n, 3] -> pixels [n, 2]."""
    pose = np.array(camera.world_from_cam)
    in_cam = (points - pose[:, 3]) @ pose[:, :3]
    x, y = (in_cam[:, :2] / in_cam[:, 2:]).T
    single = camera.model.startswith(("SIMPLE", "RADIAL"))
    f = camera.params[:1] * 2 if single else camera.params[:2]
    cx, cy, *k = camera.params[1 if single else 2 :]
    k1, k2, p1, p2 = [*k, 0, 0, 0, 0][:4]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    dx = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    dy = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([f[0] * dx + cx, f[1] * dy + cy], 1)


LENSES = [
    StatedLens("SIMPLE_RADIAL", (30, 15, 13, -0.07), (32, 24)),
    StatedLens("PINHOLE", (30, 31, 15, 13), (32, 24)),
    StatedLens("OPENCV", (30, 33, 15, 13, 0.1, -0.05, 0.02, -0.03), (32, 24)),
]


@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_a_camera_turns_as_its_pixels_do(tmp_path, lens, orientation):
    """A point falls on the same pixel whether pixels are turned after projection or the camera before."""
    path = write_turned(tmp_path / "a.tif", SCENE.images[0], orientation)
    points = SCENE.points.xyz[:10].astype(float)
    pose = SCENE.cameras[0].pose
    plain = fit_camera(write_turned(tmp_path / "b.tif", SCENE.images[0], 1), lens, pose, "d")
    turned = fit_camera(path, lens, pose, "d")
    x, y = project(plain, points).T
    shown = {1: (x, y), 3: (32 - x, 24 - y), 6: (24 - y, x), 8: (y, 32 - x)}[orientation]
    np.testing.assert_allclose(project(turned, points), np.stack(shown, 1), atol=1e-9)
    assert np.linalg.det(np.array(turned.world_from_cam)[:, :3]) == pytest.approx(1)


def test_a_portrait_photograph_with_a_model_of_its_stored_pixels(tmp_path):
    images = [f"{i}.tif" for i in range(3)]
    for i, name in enumerate(images):
        write_turned(tmp_path / "images" / name, SCENE.images[i], 6)
    write_colmap_text(tmp_path / "sparse/0", images, camera="SIMPLE_RADIAL 240 180 201 120 90 -0.072")
    found = colmap.find(tmp_path)
    frame = carry(found.frames[0], tmp_path / "out").frame
    assert (frame.width, frame.height) == (24, 32)
    np.testing.assert_allclose(
        frame.camera.params,
        (26.8, 12, 16, -0.072),  # the model is of 240x180, the picture has 32x24
    )
    np.testing.assert_allclose(
        read_image(tmp_path / "out" / frame.path), turn_upright(SCENE.images[0], 6), atol=1 / 255
    )


@pytest.mark.parametrize("orientation", [0, 9, 255])
def test_an_orientation_that_says_nothing_turns_nothing(tmp_path, orientation):
    """Scanners and editors write 0."""
    odd = write_turned(tmp_path / "a.tif", SCENE.images[0], orientation)
    plain = write_turned(tmp_path / "b.tif", SCENE.images[0], 1)
    assert fit_camera(odd, LENSES[0], np.eye(4), "d") == fit_camera(plain, LENSES[0], np.eye(4), "d")
    np.testing.assert_array_equal(read_image(odd), read_image(plain))


@pytest.mark.parametrize("size", [(24, 32), (48, 64)])
def test_a_model_of_the_upright_pixels_is_not_turned(tmp_path, size):
    path = write_turned(tmp_path / "a.tif", SCENE.images[0], 6)
    camera = fit_camera(
        path, StatedLens("PINHOLE", (30, 30, size[0] / 2, size[1] / 2), size), SCENE.cameras[0].pose, "d"
    )
    assert camera.world_from_cam == SCENE.cameras[0].pose
    np.testing.assert_allclose(camera.params, (720 / size[0], 720 / size[0], 12, 16))


@pytest.mark.parametrize("orientation", [2, 4, 5, 7])
def test_a_mirrored_picture_has_no_camera(tmp_path, orientation):
    path = write_turned(tmp_path / "a.tif", SCENE.images[0], orientation)
    with pytest.raises(BadInputError, match=rf"a\.tif is of a picture that EXIF orientation {orientation} mirrors"):
        fit_camera(path, LENSES[0], SCENE.cameras[0].pose, "d")


@pytest.mark.parametrize(
    ("orientation", "upright"), [*((o, False) for o in range(1, 9)), *((o, True) for o in range(5, 9))]
)
def test_masks_turn_as_pixels_do(tmp_path, orientation, upright):
    mask = np.zeros((24, 32), bool)
    mask[2:9, 3:15] = True
    path = write_turned(tmp_path / "a.tif", SCENE.images[0], orientation)
    write_png(tmp_path / "m.png", 255 * (turn_upright(mask, orientation) if upright else mask).astype(np.uint8))
    fitted = fit_mask(tmp_path / "m.png", read_header(path))
    np.testing.assert_array_equal(fitted, turn_upright(mask, orientation))


@pytest.mark.parametrize(
    ("top", "name"),
    [
        ({"ftheta_p0": 1.0}, "FTHETA"),
        ({"camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({"camera_model": "VR180_L"}, "VR180_L"),
    ],
)
@pytest.mark.parametrize("each", [False, True])
def test_lenses_of_nerfstudio_that_are_no_pinhole_are_refused_by_name(tmp_path, top, name, each):
    write_pictures(tmp_path, NAMES)
    frames = nerfstudio_frames(NAMES)
    if each:
        frames[1] |= top
    write_nerfstudio(tmp_path, frames, **({} if each else top))
    with pytest.raises(BadInputError, match=rf"transforms\.json: the camera of a_{1 + each}\.png has the model {name}"):
        nerfstudio.find(tmp_path)


@pytest.mark.parametrize(
    "camera", ["THIN_PRISM_FISHEYE 32 24 30 30 16 12 0 0 0 0 0 0 0 0", "FOV 32 24 30 30 16 12 0.1", "LADYBUG 3 3 3"]
)
def test_lenses_of_colmap_that_are_not_read_are_refused_by_name(tmp_path, camera):
    write_pictures(tmp_path / "images", NAMES)
    write_colmap_text(tmp_path / "sparse", NAMES, camera=camera)
    with pytest.raises(
        BadInputError, match=rf"sparse/cameras\.txt: a camera has the model {camera.split()[0]}, which is not read"
    ):
        colmap.find(tmp_path)


@pytest.mark.parametrize("said", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True}])
def test_fisheyes_of_nerfstudio_keep_their_four_parameters(tmp_path, said):
    write_pictures(tmp_path, NAMES)
    twice = {"w": 64, "h": 48, "fl_x": 40, "fl_y": 41, "cx": 33, "cy": 25}
    write_nerfstudio(tmp_path, nerfstudio_frames(NAMES), **said, **twice, k1=0.1, k2=0.02, k3=0.003, k4=0.0004)
    for frame in nerfstudio.find(tmp_path).frames:
        assert frame.camera.model == "OPENCV_FISHEYE"
        np.testing.assert_allclose(frame.camera.params, (20, 20.5, 16.5, 12.5, 0.1, 0.02, 0.003, 0.0004))


@pytest.mark.parametrize(
    ("model", "params"),
    [("OPENCV_FISHEYE", (20, 21, 16, 12, 0.1, 0.2, 0.3, 0.4)), ("SIMPLE_RADIAL_FISHEYE", (20, 16, 12, 0.1)),
     ("RADIAL_FISHEYE", (20, 16, 12, 0.1, 0.2))],
)  # fmt: skip
def test_fisheyes_of_colmap(tmp_path, model, params):
    write_pictures(tmp_path / "images", NAMES)
    write_colmap_text(tmp_path / "sparse", NAMES, camera=f"{model} 32 24 {' '.join(map(str, params))}")
    camera = colmap.find(tmp_path).frames[0].camera
    assert (camera.model, camera.params) == (model, params)


def test_each_frame_has_the_lens_that_is_listed_with_it(tmp_path):
    write_pictures(tmp_path, NAMES)
    frames = nerfstudio_frames(NAMES)
    frames[1] |= {"fl_x": 50, "fl_y": 51, "cx": 15, "cy": 11}
    frames[2] |= {"k1": 0.2, "p2": 0.01, "w": 64, "h": 48, "cx": 32, "cy": 24}
    write_nerfstudio(tmp_path, frames)
    first, second, third = (f.camera for f in nerfstudio.find(tmp_path).frames)
    f = SCENE.cameras[0].fx
    np.testing.assert_allclose(first.params, (f, f, 16, 12))
    assert second.params == (50, 51, 15, 11)
    assert third.model == "OPENCV"
    np.testing.assert_allclose(third.params, (f / 2, f / 2, 16, 12, 0.2, 0, 0, 0.01))


BAD_ROTATIONS = {
    "nan": (np.diag([1, 1, np.nan]), "3 values|1 values"),
    "mirrored": (np.diag([1, 1, -1]), "determinant -1"),
    "scaled": (2 * np.eye(3), "determinant 8"),
    "sheared": (np.array([[1, 0.2, 0], [0, 1, 0], [0, 0, 1]]), r"axes off by 0\.1[78]"),
    "nothing": (np.zeros((3, 3)), "determinant 0"),
}


@pytest.mark.parametrize("kind", BAD_ROTATIONS)
@pytest.mark.parametrize("layout", ["nerfstudio", "llff"])
def test_a_pose_without_a_rotation_is_refused_with_its_frame(tmp_path, kind, layout):
    factor, message = BAD_ROTATIONS[kind]
    write_pictures(tmp_path, NAMES)
    if layout == "nerfstudio":
        frames = nerfstudio_frames(NAMES)
        pose = np.array(frames[1]["transform_matrix"])
        pose[:3, :3] = pose[:3, :3] @ factor
        frames[1]["transform_matrix"] = pose.tolist()
        write_nerfstudio(tmp_path, frames)
    else:
        write_llff(tmp_path, range(3))
        rows = np.load(tmp_path / "poses_bounds.npy")
        pose = rows[1, :15].reshape(3, 5)
        pose[:, :3] = pose[:, :3] @ factor
        np.save(tmp_path / "poses_bounds.npy", rows)
    module, file = (nerfstudio, r"transforms\.json") if layout == "nerfstudio" else (llff, r"poses_bounds\.npy")
    with pytest.raises(
        BadInputError, match=rf"{file}: the camera of a_2\.png .*({message if kind != 'nan' else 'not finite'})"
    ):
        module.find(tmp_path)


@pytest.mark.parametrize("row", [[0, 0, 0, 2], [0, 0, 0, 0], [0, 0, 1, 1]])
def test_a_matrix_that_scales_by_its_last_row_is_refused_with_its_frame(tmp_path, row):
    write_pictures(tmp_path, NAMES)
    frames = nerfstudio_frames(NAMES)
    frames[1]["transform_matrix"][3] = row
    write_nerfstudio(tmp_path, frames)
    with pytest.raises(BadInputError, match=r"transforms\.json: the camera of .*the last row of its pose"):
        nerfstudio.find(tmp_path)


@pytest.mark.parametrize("where", [3, 7, 11])
@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e400"])
def test_a_place_that_is_not_finite_is_refused_with_its_frame(tmp_path, where, value):
    write_pictures(tmp_path, NAMES)
    frames = nerfstudio_frames(NAMES)
    frames[2]["transform_matrix"][where // 4][3] = "HERE"
    write_nerfstudio(tmp_path, frames)
    path = tmp_path / "transforms.json"
    path.write_text(path.read_text().replace('"HERE"', value))
    with pytest.raises(
        BadInputError, match=r"transforms\.json: the camera of a_3\.png .* 1 values that are not finite"
    ):
        nerfstudio.find(tmp_path)


@pytest.mark.parametrize(
    "wrong",
    [{"fl_x": 0}, {"fl_x": -30}, {"fl_y": -1}, {"w": 0}, {"w": -32}, {"h": -24}, {"fl_x": float("nan")},
     {"cx": float("inf")}, {"w": 24}, {"camera_angle_x": 0, "fl_x": None}, {"transform_matrix": [[1, 2]]},
     {"cx": "left"}, {"cx": 1e30}, {"cy": -80}, {"fl_x": True}, {"is_fisheye": "false"}],
)  # fmt: skip
def test_a_lens_that_cannot_be_is_refused_with_its_frame(tmp_path, wrong):
    write_pictures(tmp_path, NAMES)
    frames = nerfstudio_frames(NAMES)
    frames[1] |= wrong
    write_nerfstudio(tmp_path, frames)
    with pytest.raises(BadInputError, match=r"transforms\.json: the camera of a_2\.png"):
        nerfstudio.find(tmp_path)


def test_black_is_the_hole_in_mask_path_and_depth_is_not_read(tmp_path):
    write_pictures(tmp_path, NAMES)
    hole = np.zeros((24, 32), bool)
    hole[5:9, 7:20] = True
    write_png(tmp_path / "person/0.png", np.where(hole, np.uint8(0), np.uint8(255)))
    frames = nerfstudio_frames(NAMES)
    frames[1] |= {"mask_path": "person/0.png", "depth_file_path": "depth/0.exr"}
    write_nerfstudio(tmp_path, frames)
    found = nerfstudio.find(tmp_path)
    carried = [carry(f, tmp_path / "out") for f in found.frames]
    assert [c.mask_share for c in carried] == [None, hole.mean(), None]
    assert "names 1 depth pictures (depth_file_path), which are not read" in found.notes[0]
    frames[2]["mask_path"] = "person/gone.png"
    write_nerfstudio(tmp_path, frames)
    with pytest.raises(BadInputError, match=r"mask_path person/gone\.png is not there"):
        nerfstudio.find(tmp_path)


def test_mask_path_is_of_the_codes_0_and_1_too(tmp_path):
    write_pictures(tmp_path, NAMES)
    keep = np.ones((24, 32), np.uint8)
    keep[5:9, 7:20] = 0
    write_png(tmp_path / "m.png", keep)
    write_nerfstudio(tmp_path, [{**f, "mask_path": "m.png"} for f in nerfstudio_frames(NAMES)])
    frame = nerfstudio.find(tmp_path).frames[0]
    assert carry(frame, tmp_path / "out").mask_share == pytest.approx((keep == 0).mean())


def test_an_angle_of_view_is_a_focal_length(tmp_path):
    write_pictures(tmp_path, NAMES)
    frames = [{"file_path": NAMES[0], "transform_matrix": opengl_pose(SCENE.cameras[0])}]
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": 2 * np.arctan(16 / 40), "frames": frames}))
    np.testing.assert_allclose(nerfstudio.find(tmp_path).frames[0].camera.params, (40, 40, 16, 12))


@pytest.mark.parametrize("share", [0.0, 0.4])
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_transparent_pixels_take_their_neighbours_colour_and_stay_transparent(tmp_path, share, suffix):
    picture = np.zeros((24, 32, 4), np.float32)
    picture[..., 1], picture[..., 3] = 0.6, 1
    picture[:, : int(32 * share)] = (1, 0, 1, 0)
    path = write_turned(tmp_path / f"a{suffix}", picture, 1)
    carried = carry(FoundFrame("a", path), tmp_path / "out")
    assert carried.transparent_share == pytest.approx(int(32 * share) / 32)
    np.testing.assert_allclose(
        read_image(tmp_path / "out" / carried.frame.path), np.broadcast_to([0, 0.6, 0], (24, 32, 3))
    )


def test_a_picture_that_is_transparent_everywhere_is_refused(tmp_path):
    path = write_turned(tmp_path / "a.png", np.zeros((24, 32, 4)), 1)
    with pytest.raises(BadInputError, match=r"a\.png is transparent everywhere"):
        carry(FoundFrame("a", path), tmp_path / "out")


def test_no_frame_is_written_over_another(tmp_path):
    write_pictures(tmp_path, NAMES)
    frame = FoundFrame("a", tmp_path / NAMES[0])
    carry(frame, tmp_path / "out")
    with pytest.raises(BadInputError, match=r"a_2\.png: another picture has the name a already"):
        carry(dataclasses.replace(frame, image=tmp_path / NAMES[1]), tmp_path / "out")


@pytest.mark.parametrize(
    ("size", "alike"), [((43, 31), True), ((44, 28), True), ((50, 28), False), ((28, 40), False), ((1000, 700), True)]
)
def test_small_pictures_have_an_aspect_as_far_as_whole_pixels_allow(size, alike):
    assert same_aspect((10, 7), size) is alike
    assert same_aspect(size, (10, 7)) is alike
