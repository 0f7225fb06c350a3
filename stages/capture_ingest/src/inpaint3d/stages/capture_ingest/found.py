"""What every layout finds: pictures with, perhaps, a mask and a camera; how they are named and told apart."""

import os
import re
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES
from inpaint3d.contracts.models.base import Pose


@dataclass(frozen=True)
class FoundFrame:
    """One picture on disk. `camera` is for the upright picture's own size; None: to be found from the pictures."""

    name: str
    image: Path
    mask: Path | None = None
    camera: KnownCamera | None = None
    other_pose: Pose | None = None  # see CapturedFrame
    hole_is_black: bool = False  # nerfstudio's masks say what is to be used


@dataclass(frozen=True)
class Found:
    """A capture's frames in capture order, and the views kept back as truth."""

    layout: str
    frames: list[FoundFrame]
    truth: list[FoundFrame] = field(default_factory=list)
    ordered: bool = True
    notes: list[str] = field(default_factory=list)


def one_folder(frames: list[FoundFrame]) -> bool:
    """Whether neighbours were taken one after the other: each camera's folder begins anew."""
    return len({f.image.parent for f in frames}) <= 1


Key = tuple[tuple[int, str], ...]
MAX_DEPTH = 20


def numeric_order(path: PurePath) -> tuple[Key, ...]:
    """Sort key by which frame_10 comes after frame_9, folder by folder."""
    parts = (*path.parts[:-1], path.stem)
    return tuple(
        tuple((int(run), "") if run.isdecimal() else (-1, run) for run in re.split(r"(\d+)", part)) for part in parts
    )


def normalise_name(text: str) -> str:
    """One spelling of what looks alike: macOS writes accents apart from their letters (NFD)."""
    return unicodedata.normalize("NFC", text)


def find_subfolder(root: Path, name: str) -> Path:
    """A folder of `root` by its name, in whatever case it is written; the path as given where there is none."""
    if (root / name).is_dir() or not root.is_dir():
        return root / name
    return next((p for p in sorted(root.iterdir()) if p.is_dir() and p.name.lower() == name), root / name)


def picture_folder(root: Path) -> Path:
    """`images/`, else the top."""
    return folder if (folder := find_subfolder(root, "images")).is_dir() else root


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder, without its sub-folders, in numeric order."""
    return _sort_pictures(folder.iterdir()) if folder.is_dir() else []


def pictures_below(folder: Path, without: frozenset[str] = frozenset()) -> list[Path]:
    """The pictures of a folder and its sub-folders, except those named `without`, in numeric order."""
    return _sort_pictures(files_below(folder, without))


def files_below(folder: Path, without: frozenset[str] = frozenset()) -> Iterator[Path]:
    """The files of a folder and its sub-folders, those that are links too; hidden ones are passed over."""
    for place, folders, names in os.walk(folder, followlinks=True):
        if len(Path(place).relative_to(folder).parts) > MAX_DEPTH:
            raise BadInputError(
                f"{folder.name}/ has folders in folders beyond {MAX_DEPTH}; does a link lead in a circle?"
            )
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name.lower() not in without)
        yield from (Path(place, name) for name in sorted(names) if not name.startswith("."))


def _sort_pictures(paths: Iterable[Path]) -> list[Path]:
    return sorted((p for p in paths if is_picture(p)), key=numeric_order)


def is_picture(path: Path) -> bool:
    """By its name, and that it is a file; what begins with a dot (macOS's ._ files) is not."""
    return path.suffix.lower() in PICTURE_SUFFIXES and not path.name.startswith(".") and path.is_file()


def name_pictures(paths: Sequence[Path]) -> dict[Path, str]:
    """A name for each picture: its stem, and before it the folders below the one that all of them share.

    BadInputError where two would have one name: one would overwrite the other.
    """
    if not paths:
        return {}
    shared = Path(os.path.commonpath([p.parent for p in paths]))
    names: dict[str, Path] = {}
    for path in paths:
        text = "_".join(path.relative_to(shared).with_name(path.stem).parts)
        name = normalise_name(text).replace("\\", "_")
        if (other := names.setdefault(name, path)) is not path:
            a, b = (p.relative_to(shared).as_posix() for p in (other, path))
            what = f"{a} is listed twice; list it once" if a == b else f"{a} and {b} have the same name; rename one"
            raise BadInputError(f"{what} (in {shared.name}/)")
    return {path: name for name, path in names.items()}


def masks_for(pictures: Sequence[Path], folder: Path) -> dict[Path, Path]:
    """Picture -> its mask in `folder`: of its name with or without the picture's own suffix (a.png, a.jpg.png).

    BadInputError for a mask of no picture: it is most likely misnamed.
    """
    masks = pictures_below(folder)
    if not masks or not pictures:
        return {}
    shared = Path(os.path.commonpath([p.parent for p in pictures]))
    keys = {_make_key(p.relative_to(shared)): p for p in pictures} | {
        _make_key(p.relative_to(shared).with_suffix("")): p for p in pictures
    }
    found: dict[Path, Path] = {}
    strange: list[str] = []
    for mask in masks:
        listed = mask.relative_to(folder)
        picture = keys.get(_make_key(listed.with_suffix("")))
        if picture is None:
            strange.append(listed.as_posix())
        elif (other := found.setdefault(picture, mask)) is not mask:
            raise BadInputError(
                f"{folder.name}/{other.relative_to(folder)} and {listed} are both masks of {picture.name}; remove one"
            )
    if strange:
        raise BadInputError(
            f"{folder.name}/{strange[0]} has no picture of that name ({len(strange)} such masks); "
            "give masks the names of their pictures"
        )
    return found


def _make_key(path: PurePath) -> str:
    return normalise_name(path.as_posix())


def _fold(path: str) -> str:
    return normalise_name(path).lower()


class SourceFiles:
    """The files of a source, found by what a data set's document calls them; never a file outside it."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.relocated: list[str] = []
        """What is listed by a place outside the source, and was found inside."""
        self._exact = {p.relative_to(root).as_posix(): p for p in files_below(root)}

    def find(self, listed: object, document: str, below: tuple[str, ...] = ("",)) -> Path | None:
        """The file, looked for `below` these folders; None where there is none.

        A place outside the source (absolute, or by `..`) is looked for by its last parts inside;
        BadInputError where they are not there.
        """
        if not isinstance(listed, str) or not listed.strip():
            raise BadInputError(f"{document}: {listed!r} is no path of a file; export it again")
        text = listed if "\\" not in listed or PurePath(listed).as_posix() in self._exact else listed.replace("\\", "/")
        outside = re.match(r"([A-Za-z]:)?/|[A-Za-z]:", text) or os.path.normpath(text).split("/")[0] == ".."
        if not outside:
            return next((p for folder in below if (p := self._look_up(os.path.normpath(f"./{folder}/{text}")))), None)
        parts = [part for part in text.split("/") if part not in ("", ".", "..")]
        for start in range(len(parts)):
            if path := self._look_up("/".join(parts[start:])):
                self.relocated.append(listed)
                return path
        raise BadInputError(
            f"{document}: {listed} lies outside the capture; put the file inside and list it by a relative path"
        )

    def _look_up(self, relative: str) -> Path | None:
        if path := self._exact.get(relative):
            return path
        # Documents from systems that don't tell upper case from lower, or accents from NFD; lists without suffixes.
        key = _fold(relative)
        for folded in (key, *(f"{key}{suffix}" for suffix in (".png", ".jpg", ".jpeg"))):
            if len(alike := self._folded.get(folded, [])) == 1:
                return alike[0]
        return None

    @cached_property
    def _folded(self) -> dict[str, list[Path]]:
        folded: dict[str, list[Path]] = {}
        for key, path in self._exact.items():
            folded.setdefault(_fold(key), []).append(path)
        return folded

    def notes(self, document: str) -> list[str]:
        """What is to be said of files that were listed at other places."""
        if not self.relocated:
            return []
        return [
            f"{document} lists {len(self.relocated)} files outside the capture ({self.relocated[0]}); "
            "those of the same names inside are taken"
        ]
