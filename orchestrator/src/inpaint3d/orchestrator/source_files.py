"""Which files a capture's folder consists of: never one outside it, and none that a run left behind in it."""

import unicodedata
from collections.abc import Iterator
from pathlib import Path

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts.capture import PICTURE_SUFFIXES, VIDEO_SUFFIXES

RESULTS = ("metrics.json", "logs")
STORE = ("objects", "work", "tmp", "locks", "quarantine")


def list_source_files(root: Path) -> list[Path]:
    """The files below a folder, sorted, without hidden ones, results of runs and stores.

    A link is followed where its target lies inside. A link at the top to a folder elsewhere is where the photographs
    are kept, and gives its pictures and clips. Every other link to the outside raises BadInputError, by name.
    """
    return sorted(_walk(root, root, root.resolve(), media_only=False))


def _walk(folder: Path, root: Path, inside: Path, *, media_only: bool) -> Iterator[Path]:
    """`inside`: the real folder that no link may leave."""
    for path in sorted(folder.iterdir()):
        if path.name.startswith("."):
            continue
        within, only = inside, media_only
        if path.is_symlink():
            target = _resolve_link(path)
            if not target.is_relative_to(inside):
                if folder != root or not target.is_dir() or root.resolve().is_relative_to(target):
                    raise BadInputError(
                        f"{path} is a link to {target}, outside the capture; put a copy of the file there, or give the "
                        "folder that holds both"
                    )
                within, only = target, True
            elif target.is_dir() and folder.resolve().is_relative_to(target):
                raise BadInputError(f"{path} is a link to {target}, which it lies in itself; remove the link")
        if path.is_dir():
            if not _is_own_output(path):
                yield from _walk(path, root, within, media_only=only)
        elif path.is_file() and (not only or path.suffix.lower() in PICTURE_SUFFIXES | VIDEO_SUFFIXES):
            _check_name(path, root)
            yield path


def _resolve_link(path: Path) -> Path:
    try:
        return path.resolve(strict=True)
    except (OSError, RuntimeError) as error:  # RuntimeError: a link to itself, until Python 3.13
        raise BadInputError(f"{path} is a link to {path.readlink()}, which is not there; remove it") from error


def _is_own_output(folder: Path) -> bool:
    """Whether a run wrote it: a folder with results, the one that holds such folders, or a store."""

    def holds(place: Path, names: tuple[str, ...]) -> bool:
        return all((place / name).exists() for name in names)

    runs = (p for p in folder.iterdir() if p.is_dir())
    return holds(folder, RESULTS) or holds(folder, STORE) or any(holds(run, RESULTS) for run in runs)


def _check_name(path: Path, root: Path) -> None:
    """A name has to fit into a manifest, on every system."""
    name = path.relative_to(root).as_posix()
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise BadInputError(f"{root}: the name {name!r} is not UTF-8; rename the file") from error
    if "\\" in name:
        raise BadInputError(f"{path}: its name holds a backslash; rename it")
    if any(unicodedata.category(c) == "Cc" for c in name):
        raise BadInputError(f"{root}: the name {name!r} holds a control character; rename the file")
