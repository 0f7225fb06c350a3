"""Painted views: what counts as painted, what is ignored, what is refused."""

from pathlib import Path

import numpy as np
import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import PaintedView, PaintedViews
from inpaint3d.contracts.store import Artifact, FolderStore
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.paintings import Painting, read_painting, reduce_painting

SIDE = 40
ALLOWED = np.zeros((SIDE, SIDE), bool)
ALLOWED[10:30, 10:30] = True
ASKED = np.full((SIDE, SIDE, 3), 0.4, np.float32)


def put(tmp_path: Path, picture: np.ndarray) -> Artifact[PaintedViews]:
    store = FolderStore(tmp_path / "store")
    folder = store.private_folder()
    write_png(folder / "pictures" / "a.png", picture)
    write_png(folder / "asked" / "a.png", ASKED)
    write_mask(folder / "masks" / "a.png", ALLOWED)
    view = PaintedView(name="a", picture="pictures/a.png", mask="masks/a.png", asked="asked/a.png")
    return store.open(store.put(folder, "painted-views", PaintedViews(views=(view,))), PaintedViews)


def paint(rows: slice, columns: slice) -> np.ndarray:
    picture = ASKED.copy()
    picture[rows, columns] = (0.9, 0.1, 0.1)
    return picture


def test_what_was_painted_inside_the_mask_counts_and_the_rest_is_ignored(tmp_path: Path) -> None:
    painted = put(tmp_path, paint(slice(20, 40), slice(15, 25)))
    painting = read_painting(painted, painted.metadata.views[0])
    expected = np.zeros_like(ALLOWED)
    expected[20:30, 15:25] = True
    np.testing.assert_array_equal(painting.mask, expected)
    assert painting.ignored == pytest.approx(0.5)


def test_another_program_s_rounding_is_no_paint(tmp_path: Path) -> None:
    rounded = paint(slice(20, 30), slice(15, 25)) + np.float32(1 / 255)
    painted = put(tmp_path, rounded)
    assert read_painting(painted, painted.metadata.views[0]).mask.sum() == 100


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (ASKED, "a.png is as it was asked for"),
        (paint(slice(0, 8), slice(0, 8)), "a.png was painted outside its mask alone"),
        (paint(slice(20, 30), slice(15, 25))[:, :30], "a.png is 30x40 but was asked for at 40x40"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path: Path, picture: np.ndarray, message: str) -> None:
    painted = put(tmp_path, picture)
    with pytest.raises(BadInputError, match=message):
        read_painting(painted, painted.metadata.views[0])


def test_a_painting_is_brought_to_its_view_s_size() -> None:
    large = Painting(paint(slice(10, 30), slice(10, 30)), ALLOWED)
    small = reduce_painting(large, "a", 20, 20)
    np.testing.assert_array_equal(small.mask, ALLOWED[::2, ::2])
    np.testing.assert_allclose(small.picture[small.mask], [[0.9, 0.1, 0.1]] * 100, atol=1e-6)
    for size in ((80, 80), (20, 15)):
        with pytest.raises(BadInputError, match=f"painted view a is 40x40 but the view is {size[0]}x{size[1]}"):
            reduce_painting(large, "a", *size)
