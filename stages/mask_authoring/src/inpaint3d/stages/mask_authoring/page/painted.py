"""Painted views that are dropped on the page: kept in a folder that `run --painted` reads."""

from http import HTTPStatus
from pathlib import Path

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.page_server import Refusal
from inpaint3d.scene.image_io import read_header, read_stored

ASKED = "asked"
GIVEN_OUT = (ASKED, "masks", "cutouts")
"""Folders of what a person paints in: the present fill, the mask, the same picture transparent under the mask."""
INCOMING = ".incoming"
SUFFIXES = (".png", ".tif", ".tiff")


class PaintedFolder:
    """What was asked for lies in `asked/NAME.png`, what was painted in `NAME.png` or `NAME.tif`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def views(self) -> dict[str, bool]:
        """The views that were asked for, and whether each is painted."""
        return {path.stem: bool(self._find(path.stem)) for path in sorted((self.folder / ASKED).glob("*.png"))}

    def read(self, part: str, name: str) -> bytes:
        """A picture of those that are given out."""
        if part not in GIVEN_OUT or name not in self.views():
            raise Refusal(HTTPStatus.NOT_FOUND, "there is no such picture here")
        return (self.folder / part / f"{name}.png").read_bytes()

    def take(self, file_name: str, data: bytes) -> None:
        """Keep a painted picture, whole or not at all, in place of an earlier one of its view.

        BadInputError where it is of no view that was asked for, of another size, damaged, or as it was given out.
        """
        path = Path(file_name)
        if path.name != file_name or path.suffix.lower() not in SUFFIXES or path.stem not in self.views():
            raise BadInputError(
                f"{file_name} is none of the views that were asked for; name it {', '.join(self.views())}, "
                f"with {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
            )
        staged = self.folder / INCOMING / file_name
        staged.parent.mkdir(exist_ok=True)
        try:
            staged.write_bytes(data)
            self._check(staged)
            self.remove(path.stem)
            staged.replace(self.folder / file_name)
        finally:
            staged.unlink(missing_ok=True)

    def remove(self, name: str) -> None:
        """Forget what was painted in a view."""
        for path in self._find(name):
            path.unlink()

    def _find(self, name: str) -> list[Path]:
        return [p for p in self.folder.iterdir() if p.stem == name and p.suffix.lower() in SUFFIXES]

    def _check(self, staged: Path) -> None:
        asked = self.folder / ASKED / f"{staged.stem}.png"
        size, expected = read_header(staged).upright_size, read_header(asked).upright_size
        if size != expected:
            raise BadInputError(
                f"{staged.name} has {size[0]}x{size[1]} pixels, {expected[0]}x{expected[1]} were asked for; export it "
                "at the size of the picture that was given out"
            )
        if np.array_equal(read_stored(staged), read_stored(asked)):
            raise BadInputError(f"{staged.name} is as it was given out; paint in it first")
