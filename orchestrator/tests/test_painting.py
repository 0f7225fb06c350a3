"""Views to paint in: what is exported, what is taken back, and what is refused before anything runs."""

from pathlib import Path

import pytest

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import CleanPlates, PaintedViews
from inpaint3d.contracts.models.artifacts.plates import Canvas
from inpaint3d.contracts.models.base import Digest
from inpaint3d.contracts.store import FolderStore, Store
from inpaint3d.orchestrator.painting import ask, take_painted


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return FolderStore(tmp_path / "store")


def put_plates(store: Store, *names: str) -> Digest:
    """Plates with canvases whose files hold their own names."""
    folder = store.private_folder()
    (folder / "canvases").mkdir()
    (folder / "transforms.json").write_text("{}")
    canvases = []
    for name in names:
        files = {part: f"canvases/{name}{tail}.png" for part, tail in
                 (("picture", ""), ("mask", ".mask"), ("cutout", ".cutout"))}  # fmt: skip
        for path in files.values():
            (folder / path).write_text(path)
        canvases.append(Canvas(name=name, **files))
    return store.put(folder, "clean-plates", CleanPlates(plates=(), model=(), canvases=tuple(canvases)))


@pytest.fixture
def asked(store: Store, tmp_path: Path) -> Path:
    assert ask(store, "kitchen", put_plates(store, "IMG_7", "IMG_3"), tmp_path / "to-paint") == ["IMG_7", "IMG_3"]
    return tmp_path / "to-paint"


def test_what_was_painted_is_taken_with_what_was_asked(store: Store, asked: Path) -> None:
    assert "IMG_3" in (asked / "index.html").read_text()
    (asked / "IMG_7.png").unlink()
    (asked / "IMG_3.png").unlink()
    (asked / "IMG_3.TIF").write_text("painted, in another format")
    taken = store.open(take_painted(store, asked), PaintedViews)
    (view,) = taken.metadata.views
    assert (view.name, view.picture) == ("IMG_3", "pictures/IMG_3.tif")
    assert taken.path(view.picture).read_text() == "painted, in another format"
    assert view.asked is not None
    assert taken.path(view.asked).read_text() == "canvases/IMG_3.png"
    assert taken.path(view.mask).read_text() == "canvases/IMG_3.mask.png"


def test_a_picture_that_nobody_touched_or_asked_for_is_refused(store: Store, asked: Path) -> None:
    with pytest.raises(BadInputError, match=r"IMG_7\.png is as it was exported; paint in it, or remove it"):
        take_painted(store, asked)
    (asked / "IMG_7.png").rename(asked / "IMG_8.png")
    with pytest.raises(BadInputError, match=r"IMG_8\.png is none of the views that were asked for: IMG_7, IMG_3"):
        take_painted(store, asked)
    (asked / "IMG_8.png").rename(asked / "IMG_3.tif")
    with pytest.raises(BadInputError, match=r"IMG_3\.png and IMG_3\.tif are of one view"):
        take_painted(store, asked)
    for name in ("IMG_3.tif", "IMG_3.png"):
        (asked / name).unlink()
    with pytest.raises(BadInputError, match=r"no painted picture; there should be one of IMG_7, IMG_3"):
        take_painted(store, asked)


def test_a_folder_that_was_not_asked_for_is_refused(store: Store, tmp_path: Path) -> None:
    with pytest.raises(BadInputError, match=r"has no paint\.yaml; give the folder that `inpaint3d paint ask` wrote"):
        take_painted(store, tmp_path)


def test_a_run_without_plates_or_with_nothing_made_up_has_nothing_to_paint(store: Store, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"kitchen has no plates to paint in; run it again with --want"):
        ask(store, "kitchen", None, tmp_path / "new")
    with pytest.raises(ConfigurationError, match=r"nothing is made up in kitchen"):
        ask(store, "kitchen", put_plates(store), tmp_path / "new")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("mine")
    with pytest.raises(ConfigurationError, match=r"full is not empty"):
        ask(store, "kitchen", put_plates(store, "a"), tmp_path / "full")
