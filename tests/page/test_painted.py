"""Painted views that are dropped on the page: what is kept, what is refused, and that a run takes them."""

from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.page_server import Refusal
from inpaint3d.contracts.models.artifacts import CleanPlates, PaintedViews
from inpaint3d.contracts.models.artifacts.plates import Canvas
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.painting import offer, take_painted
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.mask_authoring.page.painted import PaintedFolder

ASKED, PAINTED = np.full((6, 8, 3), 0.2), np.full((6, 8, 3), 0.7)


def put_plates(store: FolderStore, *names: str) -> Digest:
    """Plates with these views to paint in."""
    folder = store.private_folder()
    (folder / "transforms.json").write_text("{}")
    canvases = []
    for name in names:
        files = {part: f"canvases/{name}.{part}.png" for part in ("picture", "mask", "cutout")}
        for path in files.values():
            write_png(folder / path, ASKED)
        canvases.append(Canvas(name=name, **files))
    return store.put(folder, "clean-plates", CleanPlates(plates=(), model=(), canvases=tuple(canvases)))


def encode(folder: Path, picture: np.ndarray) -> bytes:
    write_png(folder / "encoded.png", picture)
    return (folder / "encoded.png").read_bytes()


@pytest.fixture
def store(tmp_path: Path) -> FolderStore:
    return FolderStore(tmp_path / "store")


@pytest.fixture
def folder(store: FolderStore, tmp_path: Path) -> PaintedFolder:
    offered = offer(store, "kitchen", put_plates(store, "IMG_3", "IMG_7"), tmp_path / "painted")
    assert offered == tmp_path / "painted"
    return PaintedFolder(offered)


def test_what_is_dropped_is_what_a_run_takes_and_may_be_dropped_again_or_taken_back(folder, store, tmp_path):
    assert folder.views() == {"IMG_3": False, "IMG_7": False}
    folder.take("IMG_7.png", encode(tmp_path, 0.5 * PAINTED))
    folder.take("IMG_7.png", encode(tmp_path, PAINTED))
    assert folder.views() == {"IMG_3": False, "IMG_7": True}
    taken = store.open(take_painted(store, folder.folder), PaintedViews)
    (view,) = taken.metadata.views
    assert taken.path(view.picture).read_bytes() == encode(tmp_path, PAINTED)
    folder.remove("IMG_7")
    assert folder.views() == {"IMG_3": False, "IMG_7": False}


def test_other_plates_are_asked_about_anew_unless_something_is_painted(folder, store, tmp_path):
    offer(store, "kitchen", put_plates(store, "IMG_9"), folder.folder)
    assert folder.views() == {"IMG_9": False}
    folder.take("IMG_9.png", encode(tmp_path, PAINTED))
    offer(store, "kitchen", put_plates(store, "IMG_1"), folder.folder)
    assert folder.views() == {"IMG_9": True}


def test_nothing_is_offered_where_nothing_is_made_up(store, tmp_path):
    assert offer(store, "kitchen", None, tmp_path / "none") is None
    assert offer(store, "kitchen", put_plates(store), tmp_path / "none") is None
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize(
    ("name", "picture", "says"),
    [
        ("IMG_8.png", PAINTED, "IMG_8.png is none of the views .* name it IMG_3, IMG_7"),
        ("../IMG_3.png", PAINTED, "is none of the views"),
        ("IMG_3.gif", PAINTED, "is none of the views"),
        ("IMG_3.png", PAINTED[:5], "IMG_3.png has 8x5 pixels, 8x6 were asked for"),
        ("IMG_3.png", ASKED, "IMG_3.png is as it was given out"),
        ("IMG_3.png", None, "IMG_3.png"),
    ],
)
def test_a_picture_that_cannot_be_used_is_refused_and_leaves_nothing(folder, tmp_path, name, picture, says):
    before = sorted(path for path in folder.folder.rglob("*") if path.is_file())
    with pytest.raises(BadInputError, match=says):
        folder.take(name, b"no picture" if picture is None else encode(tmp_path, picture))
    assert sorted(path for path in folder.folder.rglob("*") if path.is_file()) == before


def test_what_is_given_out_is_given_by_its_name_alone(folder):
    assert folder.read("masks", "IMG_3") == (folder.folder / "masks/IMG_3.png").read_bytes()
    for part, name in (("", "paint.yaml"), ("masks", "../asked/IMG_3"), ("..", "IMG_3")):
        with pytest.raises(Refusal):
            folder.read(part, name)
