"""A folder of photos: pictures at its top, or `images/` with, optionally, `masks/` and `truth/` beside it.

Where there are none but in sub-folders (one for each camera), those are taken.
"""

from pathlib import Path

from inpaint3d.contracts.models.artifacts.capture import UNREADABLE_SUFFIXES
from inpaint3d.stages.capture_ingest.found import (
    Found,
    FoundFrame,
    find_subfolder,
    masks_for,
    name_pictures,
    picture_folder,
    pictures_below,
    pictures_in,
)

BESIDE = frozenset(["masks", "truth"])


def find(root: Path) -> Found:
    """Frames without cameras. Photos are taken to be in order when every name holds a number: cameras count."""
    folder = picture_folder(root)
    pictures = list_photos(root)
    names = name_pictures(pictures)
    masks = masks_for(pictures, find_subfolder(root, "masks"))
    frames = [FoundFrame(names[p], p, masks.get(p)) for p in pictures]
    shown = pictures_in(find_subfolder(root, "truth")) if folder != root else []
    truth_names = name_pictures(shown)
    truth = [FoundFrame(truth_names[p], p) for p in shown]
    folders = {p.parent for p in pictures}
    ordered = len(folders) <= 1 and all(any(c.isdigit() for c in p.stem) for p in pictures)
    return Found("photos", frames, truth, ordered, list_unread(folder))


def list_photos(root: Path) -> list[Path]:
    """The pictures at the top, else those of the sub-folders."""
    folder = picture_folder(root)
    return pictures_in(folder) or pictures_below(folder, without=BESIDE)


def list_unread(folder: Path) -> list[str]:
    """A note on pictures of kinds that are not read."""
    unread = [p for p in sorted(folder.rglob("*")) if p.suffix.lower() in UNREADABLE_SUFFIXES]
    if not unread:
        return []
    way_out = UNREADABLE_SUFFIXES[unread[0].suffix.lower()]
    return [f"{len(unread)} pictures are of kinds that are not read and left out ({unread[0].name}: {way_out})"]
