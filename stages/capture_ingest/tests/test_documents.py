"""What a data set's documents list: inside the capture, whole, and counted."""

import struct

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.image_io import write_mask
from inpaint3d.stages.capture_ingest import colmap, llff, nerfstudio
from inpaint3d.stages.capture_ingest.carry import carry
from inpaint3d.stages.capture_ingest.run import describe_carried
from tests.data_sets import (
    SCENE,
    nerfstudio_frames,
    write_colmap_binary,
    write_colmap_text,
    write_llff,
    write_nerfstudio,
    write_pictures,
)

NAMES = ["a_1.png", "a_2.png", "a_3.png"]


@pytest.fixture
def root(tmp_path):
    write_pictures(tmp_path / "raw/images", NAMES)
    write_pictures(tmp_path / "elsewhere", ["b_1.png"])
    return tmp_path / "raw"


@pytest.mark.parametrize(
    "listed", ["{outside}/b_1.png", "../elsewhere/b_1.png", "images/../../elsewhere/b_1.png", "C:\\b_1.png"]
)
@pytest.mark.parametrize("key", ["file_path", "mask_path"])
def test_what_lies_outside_is_refused_by_name(root, listed, key):
    listed = listed.format(outside=root.parent / "elsewhere")
    frames = nerfstudio_frames([f"images/{n}" for n in NAMES])
    frames[1][key] = listed
    write_nerfstudio(root, frames)
    with pytest.raises(BadInputError) as caught:
        nerfstudio.find(root)
    assert f"transforms.json: {listed} lies outside the capture" in str(caught.value)


@pytest.mark.parametrize("start", ["/home/me/scene/images", "../scene/images", "D:\\scene\\images", "/images"])
def test_a_picture_that_was_elsewhere_is_found_inside_and_said(root, start):
    separator = "\\" if "\\" in start else "/"
    write_nerfstudio(root, nerfstudio_frames([f"{start}{separator}{n}" for n in NAMES]))
    found = nerfstudio.find(root)
    assert [f.image for f in found.frames] == [root / "images" / n for n in NAMES]
    assert "lists 3 files outside the capture" in found.notes[-1]


@pytest.mark.parametrize("listed", ["images\\a_1.png", "IMAGES/A_1.PNG", "images/a_1", "./images//a_1.png"])
def test_other_spellings_of_a_picture_are_understood(root, listed):
    write_nerfstudio(root, nerfstudio_frames([listed, *(f"images/{n}" for n in NAMES[1:])]))
    assert [f.image.name for f in nerfstudio.find(root).frames] == NAMES


def test_accents_may_be_written_in_two_ways(root):
    write_pictures(root / "images", ["Gro\u0308\u00dfe.png"])
    write_colmap_text(root / "sparse", ["Gr\u00f6\u00dfe.png", *NAMES])
    assert colmap.find(root).frames[0].name == "Gr\u00f6\u00dfe"


@pytest.mark.parametrize("name", ["../../elsewhere/b_1.png", "/etc/passwd"])
@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_a_model_that_names_a_file_outside_is_refused(root, write, name):
    write(root / "sparse/0", [*NAMES, name])
    with pytest.raises(BadInputError, match=rf"sparse/0: {name} lies outside the capture"):
        colmap.find(root)


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
def test_a_picture_that_a_model_names_and_that_is_absent_is_named(root, write):
    write(root / "sparse/0", [*NAMES, "gone.png"])
    with pytest.raises(BadInputError, match=r"sparse/0: the model names gone\.png, which is not in images/"):
        colmap.find(root)


@pytest.mark.parametrize("write", [write_colmap_text, write_colmap_binary])
@pytest.mark.parametrize("twice", ["a_1.png", "images/a_1.png", "A_1.png"])
def test_a_picture_that_a_model_holds_twice_is_named(root, write, twice):
    write(root / "sparse/0", ["a_1.png", twice])
    with pytest.raises(BadInputError, match=f"sparse/0: images 1 and 2 are both {twice}"):
        colmap.find(root)


@pytest.mark.parametrize("points", ["", None, "1.5 2.5 -1 3 4 17", "1e-3 2 -1"])
def test_a_text_model_is_read_with_and_without_its_lines_of_points(root, points):
    """Some tools leave out empty lines, and every second image was dropped."""
    write_colmap_text(root / "sparse/0", NAMES, said=3, points=points)
    assert [f.image.name for f in colmap.find(root).frames] == NAMES


@pytest.mark.parametrize("said", [2, 4, 300])
def test_a_text_model_that_counts_what_it_does_not_hold_is_refused(root, said):
    write_colmap_text(root / "sparse/0", NAMES, said=said)
    with pytest.raises(BadInputError, match=rf"0/images\.txt .*header counts {said} entries, but it holds 3"):
        colmap.find(root)


def test_a_line_that_is_nothing_is_named(root):
    write_colmap_text(root / "sparse/0", NAMES)
    path = root / "sparse/0/images.txt"
    path.write_text(path.read_text() + "8 1 0 0 0 0 0\n")
    with pytest.raises(BadInputError, match=r"images\.txt .*line 8 is neither"):
        colmap.find(root)


@pytest.mark.parametrize("cut", [1, 24, 40, -9])
@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
def test_a_binary_model_that_is_cut_or_too_long_is_refused(root, file, cut):
    write_colmap_binary(root / "sparse/0", NAMES)
    path = root / "sparse/0" / file
    data = path.read_bytes()
    path.write_bytes(data[:-cut] if cut > 0 else data + bytes(-cut))
    with pytest.raises(BadInputError, match=rf"0/{file} is damaged"):
        colmap.find(root)


def test_counts_that_no_file_can_hold_are_refused_at_once(root):
    write_colmap_binary(root / "sparse/0", NAMES)
    path = root / "sparse/0/images.bin"
    path.write_bytes(struct.pack("<Q", 2**62) + path.read_bytes()[8:])
    with pytest.raises(BadInputError, match=r"images\.bin is damaged"):
        colmap.find(root)


@pytest.mark.parametrize("shape", ["(4000000000, 17)", "(2, 17)", "(3, 16)", "(3, 17, 1)", "'x'"])
def test_a_numpy_file_that_claims_another_shape_is_refused(root, shape):
    write_llff(root, range(3))
    path = root / "poses_bounds.npy"
    data = path.read_bytes()
    head = data[10:128].decode().rstrip()
    new = head.replace("(3, 17)", shape).ljust(117) + "\n"
    path.write_bytes(data[:10] + new.encode() + data[128:])
    with pytest.raises(BadInputError, match=r"poses_bounds\.npy"):
        llff.find(root)


def test_a_pickle_is_never_opened(root):
    np.save(root / "poses_bounds.npy", np.array([{"a": 1}], object), allow_pickle=True)
    with pytest.raises(BadInputError, match=r"poses_bounds\.npy cannot be read"):
        llff.find(root)


def test_masks_that_say_nothing_are_counted_aloud(root, tmp_path):
    write_mask(root / "masks/a_1.png", np.zeros((24, 32)))
    write_mask(root / "masks/a_2.png", np.ones((24, 32)))
    write_mask(root / "masks/a_3.png.png", SCENE.object_masks[0])
    write_nerfstudio(root, nerfstudio_frames([f"images/{n}" for n in NAMES]))
    carried = [carry(f, tmp_path / "out") for f in nerfstudio.find(root).frames]
    assert describe_carried(carried) == [
        "1 of 3 masks are empty: nothing is to be removed there (a_1)",
        "1 of 3 masks cover the whole picture (a_2)",
    ]


def test_two_masks_of_one_picture_are_refused(root):
    for name in ("a_1.png", "a_1.png.png"):
        write_mask(root / "masks" / name, SCENE.object_masks[0])
    write_nerfstudio(root, nerfstudio_frames([f"images/{n}" for n in NAMES]))
    with pytest.raises(BadInputError, match=r"are both masks of a_1\.png; remove one"):
        nerfstudio.find(root)
