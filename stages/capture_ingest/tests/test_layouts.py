"""Layouts are told apart by all of their marks, and what is taken for what is said."""

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import read_image, write_mask, write_png
from inpaint3d.stages.capture_ingest.carry import carry
from inpaint3d.stages.capture_ingest.config import Config
from inpaint3d.stages.capture_ingest.layouts import describe_folder, detect, find
from tests.clips import write_clip
from tests.data_sets import (
    SCENE,
    nerfstudio_frames,
    write_colmap_binary,
    write_colmap_text,
    write_llff,
    write_nerfstudio,
    write_pictures,
)

NAMES = ["a_1.png", "a_2.png", "a_3.png", "a_4.png"]


def taken(root, **options):
    return find(root, Config(**options), root.parent / "work")


def say(found) -> str:
    return "\n".join(found.notes)


@pytest.fixture
def root(tmp_path):
    (tmp_path / "raw").mkdir()
    return tmp_path / "raw"


def test_smaller_copies_without_labels_are_not_spin_nerf(root):
    for folder in ("images", "images_4"):
        write_pictures(root / folder, NAMES)
    write_llff(root, range(4))
    assert detect(root) == ["llff"]
    write_colmap_text(root / "sparse/0", NAMES)
    found = taken(root)
    assert (found.layout, len(found.frames), found.truth) == ("colmap", 4, [])
    assert found.notes[0].startswith("taken for colmap (by sparse/0/")
    assert found.notes[0].endswith("4 pictures, 4 cameras, 0 masks, 0 truth views")


def test_labels_without_poses_are_not_spin_nerf(root):
    write_pictures(root / "images", NAMES)
    write_pictures(root / "images_4/label", NAMES)
    assert detect(root) == ["photos"]


@pytest.mark.parametrize(
    "label_names", [[f"out_{i:05d}.png" for i in range(2)], ["0.png", "1.png"], ["a_1.png", "a_2.png"]]
)
def test_spin_nerf_labels_go_by_name_else_by_order(root, label_names):
    images = root / "images_4"
    write_pictures(images, NAMES)
    masks = [np.zeros((24, 32), bool) for _ in range(2)]
    masks[0][3:9, 4:8], masks[1][10:14, 20:30] = True, True
    for name, mask in zip(label_names, masks, strict=True):
        write_mask(images / "test_label" / name, mask)
    for name in NAMES[2:]:
        write_mask(images / "label" / name, masks[0])
    write_llff(root, range(4))
    found = taken(root, spin_nerf_truth=2)
    assert [f.name for f in found.truth] == ["a_1", "a_2"]
    assert [f.mask.name for f in found.truth] == label_names
    assert ("in order" in say(found)) == (label_names[0] != "a_1.png")
    (images / "test_label" / label_names[1]).unlink()
    if label_names[0] != "a_1.png":  # neither names nor counts fit
        with pytest.raises(BadInputError, match=rf"test_label/{label_names[0]} has no picture"):
            taken(root, spin_nerf_truth=2)


@pytest.mark.parametrize("suffix", ["", ".png"])
def test_blender_splits(root, suffix):
    for split, names in (("train", NAMES), ("test", NAMES[:2]), ("val", NAMES[:1])):
        write_pictures(root / split, names)
        listed = [f"./{split}/{n.removesuffix('.png')}{suffix}" for n in names]
        write_nerfstudio(root, nerfstudio_frames(listed), f"transforms_{split}.json")
    found = taken(root)
    assert [f.name for f in found.frames] == [f"train_a_{i}" for i in range(1, 5)]
    assert [f.name for f in found.truth] == ["test_a_1", "test_a_2"]
    assert "transforms_val.json is left out" in say(found)
    np.testing.assert_allclose(found.truth[1].camera.world_from_cam, SCENE.cameras[1].world_from_cam, atol=1e-9)
    assert taken(root, blender_truth=False).truth == []


@pytest.mark.parametrize("clips", [["IMG_3.MP4"], ["a.mov", "b.mp4"]])
@pytest.mark.parametrize("folder", ["", "images"])
def test_photos_win_over_clips_beside_them(root, clips, folder):
    write_pictures(root / folder, NAMES)
    for clip in clips:
        (root / clip).write_bytes(b"clip")
    found = taken(root)
    assert (found.layout, len(found.frames)) == ("photos", 4)
    assert f"{len(clips)} videos lie beside the pictures and are left out ({clips[0]})" in say(found)


@pytest.mark.parametrize("clip", ["images/IMG_3.MP4", "clips/day 1/a.mov"])
def test_clips_below_are_not_passed_over_in_silence(root, clip):
    (root / clip).parent.mkdir(parents=True)
    (root / clip).write_bytes(b"clip")
    assert f"({clip} is a video below it: give the file itself)" in describe_folder(root)
    write_pictures(root / "images", NAMES)
    assert "1 videos lie beside the pictures and are left out" in say(taken(root))


@pytest.mark.parametrize("suffix", [".mp4", ".mkv", ".avi"])
@pytest.mark.parametrize(
    "text", ["ffconcat version 1.0\nfile {clip}\n", "#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\nfile://{clip}\n"]
)
def test_a_list_of_other_clips_is_no_clip(root, capfd, suffix, text):
    """FFmpeg knows such lists by what is in them."""
    write_clip(root.parent / "private.mp4", [np.full((24, 32, 3), i, np.uint8) for i in (0, 90, 180)])
    (root / f"a{suffix}").write_text(text.format(clip=root.parent / "private.mp4"))
    with pytest.raises(BadInputError, match="has 0 frames that can be decoded"):
        taken(root)
    capfd.readouterr()  # what FFmpeg says of it


def test_a_clip_with_its_poster_is_a_video(root):
    write_pictures(root, NAMES[:1])
    (root / "walk.mp4").write_bytes(b"clip")
    assert detect(root) == ["video"]


@pytest.mark.parametrize("binary", [True, False])
def test_the_largest_of_several_models_is_taken_and_said(root, binary):
    write_pictures(root / "images", NAMES)
    write = write_colmap_binary if binary else write_colmap_text
    write(root / "sparse/0", NAMES[:2])
    write(root / "sparse/1", NAMES[:3])
    write(root / "sparse/10", NAMES[:2])
    found = taken(root)
    assert len(found.frames) == 3
    assert "sparse/1 is taken, the model with most pictures (3); not sparse/0 with 2, sparse/10 with 2" in say(found)
    assert "1 pictures are neither frames nor masks and left out: 1 of images/" in say(found)


def test_the_folder_of_pictures_may_be_a_link(root):
    write_pictures(root.parent / "photos", NAMES)
    (root / "images").symlink_to("../photos")
    assert [f.name for f in taken(root).frames] == ["a_1", "a_2", "a_3", "a_4"]


TWO_CAMERAS = [f"{side}/000{i}.png" for side in ("left", "right") for i in (1, 2, 3)]


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap", "photos", "photos at the top"])
def test_cameras_with_a_folder_each_keep_every_picture(root, tmp_path, layout):
    top = root if layout == "photos at the top" else root / "images"
    write_pictures(top, TWO_CAMERAS)
    if layout == "nerfstudio":
        write_nerfstudio(root, nerfstudio_frames([f"images/{n}" for n in TWO_CAMERAS]))
    elif layout == "colmap":
        write_colmap_text(root / "sparse/0", TWO_CAMERAS)
    if layout != "photos at the top":
        write_mask(root / "masks/right/0002.png", SCENE.object_masks[0])
    found = taken(root)
    carried = [carry(f, tmp_path / "out").frame for f in found.frames]
    names = [f"{side}_000{i}" for side in ("left", "right") for i in (1, 2, 3)]
    assert [f.name for f in carried] == names
    assert sorted(p.stem for p in (tmp_path / "out/frames").iterdir()) == names
    assert not found.ordered
    if layout != "photos at the top":
        assert [f.name for f in carried if f.mask] == ["right_0002"]
    for frame, image in zip(carried, [*SCENE.images, *SCENE.images], strict=False):
        np.testing.assert_allclose(read_image(tmp_path / "out" / frame.path), image, atol=0.5 / 255 + 1e-6)


@pytest.mark.parametrize("pair", [("left_1.png", "left/1.png"), ("é.png", "e\u0301.png"), ("a.png", "a.tif")])
def test_two_pictures_of_one_name_are_refused_before_one_overwrites_the_other(root, pair):
    names = [f"images/{name}" for name in pair]
    write_pictures(root, ["images/b.png", *names])
    write_nerfstudio(root, nerfstudio_frames(["images/b.png", *names]))
    with pytest.raises(BadInputError, match="have the same name; rename one"):
        taken(root)


def test_a_picture_listed_twice_is_refused(root):
    write_pictures(root, ["b.png", "a.png"])
    write_nerfstudio(root, nerfstudio_frames(["a.png", "b.png", "./a.png"]))
    with pytest.raises(BadInputError, match=r"transforms\.json lists \./a\.png twice"):
        taken(root)


@pytest.mark.parametrize("numbers", [range(1, 12), [9, 10, 100]])
def test_rows_without_names_follow_the_names_as_text(root, numbers):
    """imgs2poses.py of LLFF sorts names as text: f_10 before f_9."""
    names = [f"f_{i}.png" for i in numbers]
    write_pictures(root / "images", names)
    write_llff(root, [numbers.index(int(n[2:-4])) % 4 for n in sorted(names)])
    found = taken(root)
    assert [f.image.name for f in found.frames] == names
    for i, frame in enumerate(found.frames):
        np.testing.assert_allclose(frame.camera.world_from_cam, SCENE.cameras[i % 4].world_from_cam, atol=1e-9)
        row = numbers.index(int(sorted(names)[i][2:-4])) % 4
        np.testing.assert_allclose(frame.other_pose, SCENE.cameras[row].world_from_cam, atol=1e-9)
    assert "in the order of names as text, f_10" in say(found)
    assert "or as numbers: pose-estimation takes what the pictures support" in say(found)


def test_padded_names_have_one_order(root):
    write_pictures(root / "images", ["f_02.png", "f_10.png", "f_11.png"])
    write_llff(root, [0, 1, 2])
    found = taken(root)
    assert [f.other_pose for f in found.frames] == [None] * 3
    assert "as text" not in say(found)


@pytest.mark.parametrize(
    ("suffix", "way_out"), [(".HEIC", "heif-convert"), (".dng", "darktable-cli"), (".avif", "avifdec")]
)
def test_pictures_that_are_not_read_have_a_way_out(root, suffix, way_out):
    write_pictures(root, NAMES)
    for name in NAMES:
        (root / name).with_suffix(suffix).write_bytes(b"x")
    found = taken(root)
    assert len(found.frames) == 4
    assert f"4 pictures are of kinds that are not read and left out (a_1{suffix}: " in say(found)
    assert way_out in say(found)


def test_pictures_beside_sub_folders_are_counted_aloud(root):
    write_pictures(root, [*NAMES, "thumbnails/a_1.png"])
    write_png(root / "._a_1.png", SCENE.images[0])
    found = taken(root)
    assert len(found.frames) == 4
    assert "1 pictures are neither frames nor masks and left out: 1 of thumbnails/" in say(found)


@pytest.mark.parametrize("layout", ["photos", "nerfstudio", "colmap", "llff"])
def test_folders_in_upper_case_are_those_folders(root, layout):
    """Masks/ was passed over without a word."""
    write_pictures(root / "images", NAMES)
    write_mask(root / "Masks/a_2.png", np.eye(24, 32))
    write = {
        "nerfstudio": lambda: write_nerfstudio(root, nerfstudio_frames([f"images/{name}" for name in NAMES])),
        "colmap": lambda: write_colmap_text(root / "sparse/0", NAMES),
        "llff": lambda: write_llff(root, range(4)),
    }
    write.get(layout, lambda: (root / "images").rename(root / "IMAGES"))()
    found = taken(root)
    assert found.layout == layout
    assert [f.mask is not None for f in found.frames] == [False, True, False, False]


@pytest.mark.parametrize("layout", ["nerfstudio", "colmap", "photos"])
def test_pictures_that_are_not_taken_are_counted_by_folder(root, layout):
    write_pictures(root / "images", NAMES)
    write_pictures(root, ["images_2/b_1.png", "images_2/b_2.png", "depth/c.png", "cover.png"])
    if layout == "nerfstudio":
        write_nerfstudio(root, nerfstudio_frames([f"images/{name}" for name in NAMES[1:]]))
    if layout == "colmap":
        write_colmap_text(root / "sparse/0", NAMES[1:])
    unlisted = [] if layout == "photos" else ["1 of images/"]
    count, places = 4 + len(unlisted), ["1 of the top", "1 of depth/", "2 of images_2/", *unlisted]
    note = next(note for note in taken(root).notes if "left out" in note)
    assert note.startswith(f"{count} pictures are neither frames nor masks and left out: ")
    assert sorted(note.rpartition(": ")[2].split(", ")) == sorted(places)


@pytest.mark.parametrize("half", ["cameras.txt", "images.txt", "cameras.bin"])
@pytest.mark.parametrize("folder", ["sparse", "sparse/0"])
def test_half_a_model_is_refused_not_passed_over(root, half, folder):
    write_pictures(root / "images", NAMES)
    write_colmap_text(root / folder, NAMES)
    write_colmap_binary(root / folder, NAMES)
    for file in (root / folder).iterdir():
        if file.name != half:
            file.unlink()
    with pytest.raises(BadInputError, match=f"{folder}/{half} is half of a model"):
        taken(root)


def test_marks_of_other_layouts_are_said(root):
    write_pictures(root / "images", NAMES)
    write_nerfstudio(root, nerfstudio_frames([f"images/{name}" for name in NAMES]))
    write_colmap_text(root / "sparse/0", NAMES)
    write_llff(root, range(4))
    found = taken(root)
    assert found.layout == "nerfstudio"
    assert "it has the marks of colmap, llff, too; capture-ingest.layout=colmap takes it so" in say(found)
    assert taken(root, layout="colmap").layout == "colmap"
