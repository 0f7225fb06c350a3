"""A folder of photos: pictures at its top, or `images/` with, optionally, `masks/` and `truth/` beside it.

Where there are none but in sub-folders (one for each camera), those are taken.
"""

from pathlib import Path

from inpaint3d.contracts.models.artifacts.capture import UNREADABLE_SUFFIXES
from inpaint3d.stages.capture_ingest.found import (
    Found,
    FoundFrame,
    masks_for,
    name_pictures,
    pictures_below,
    pictures_in,
)

BESIDE = frozenset(["masks", "truth"])


def find(root: Path) -> Found:
    """Frames without cameras. Photos are taken to be in order when every name holds a number: cameras count."""
    folder = picture_folder(root)
    pictures = list_photos(root)
    names = name_pictures(pictures)
    masks = masks_for(pictures, root / "masks")
    frames = [FoundFrame(names[p], p, masks.get(p)) for p in pictures]
    shown = pictures_in(root / "truth") if folder != root else []
    truth_names = name_pictures(shown)
    truth = [FoundFrame(truth_names[p], p) for p in shown]
    folders = {p.parent for p in pictures}
    ordered = len(folders) <= 1 and all(any(c.isdigit() for c in p.stem) for p in pictures)
    return Found("photos", frames, truth, ordered, list_left_out(folder, pictures))


def picture_folder(root: Path) -> Path:
    return root / "images" if (root / "images").is_dir() else root


def list_photos(root: Path) -> list[Path]:
    """The pictures at the top, else those of the sub-folders."""
    folder = picture_folder(root)
    return pictures_in(folder) or pictures_below(folder, without=BESIDE)


def list_left_out(folder: Path, pictures: list[Path]) -> list[str]:
    """Notes on pictures that lie there and are not taken."""
    notes: list[str] = []
    if below := len(set(pictures_below(folder, without=BESIDE)) - set(pictures)):
        notes.append(f"{below} pictures in sub-folders are left out: there are pictures beside those folders")
    unread = [p for p in sorted(folder.rglob("*")) if p.suffix.lower() in UNREADABLE_SUFFIXES]
    if unread:
        notes.append(
            f"{len(unread)} pictures are of kinds that are not read and left out ({unread[0].name}: "
            f"{UNREADABLE_SUFFIXES[unread[0].suffix.lower()]})"
        )
    return notes
