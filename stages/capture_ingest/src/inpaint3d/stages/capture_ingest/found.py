"""What every layout finds: pictures with, perhaps, a mask and a camera."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import KnownCamera
from inpaint3d.scene.image_io import PICTURE_SUFFIXES


@dataclass(frozen=True)
class FoundFrame:
    """One picture on disk. `camera` is for the picture's own size; None: to be found from the pictures."""

    name: str
    image: Path
    mask: Path | None = None
    camera: KnownCamera | None = None


@dataclass(frozen=True)
class Found:
    """A capture's frames in capture order, and the views kept back as truth."""

    layout: str
    frames: list[FoundFrame]
    truth: list[FoundFrame] = field(default_factory=list)
    ordered: bool = True
    notes: list[str] = field(default_factory=list)


def numeric_order(path: Path) -> list[tuple[int, str]]:
    """Sort key by which frame_10 comes after frame_9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", path.stem)]


def pictures_in(folder: Path) -> list[Path]:
    """The pictures of a folder in numeric order; BadInputError where two have one stem."""
    files = (
        [p for p in folder.iterdir() if p.is_file() and p.suffix.lower() in PICTURE_SUFFIXES] if folder.is_dir() else []
    )
    by_stem: dict[str, Path] = {}
    for path in sorted(files, key=numeric_order):
        if (other := by_stem.setdefault(path.stem, path)) is not path:
            raise BadInputError(f"{other.name} and {path.name} in {folder.name}/ have the same name; rename one")
    return list(by_stem.values())


def masks_for(frames: list[Path], folder: Path) -> dict[str, Path]:
    """Stem -> mask. BadInputError for a mask of no picture: it is most likely misnamed."""
    masks = {p.stem: p for p in pictures_in(folder)}
    stems = {p.stem for p in frames}
    if strange := sorted(set(masks) - stems):
        raise BadInputError(
            f"{folder.name}/{masks[strange[0]].name} has no picture of that name ({len(strange)} such masks); "
            "give masks the names of their pictures"
        )
    return masks
