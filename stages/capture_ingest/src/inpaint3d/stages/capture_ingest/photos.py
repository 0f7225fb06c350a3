"""A folder of photos: pictures at its top, or `images/` with, optionally, `masks/` and `truth/` beside it."""

from pathlib import Path

from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, masks_for, pictures_in


def find(root: Path) -> Found:
    """Frames without cameras. Photos are taken to be in order when every name holds a number: cameras count."""
    folder = root / "images" if (root / "images").is_dir() else root
    pictures = pictures_in(folder)
    masks = masks_for(pictures, root / "masks") if folder != root else {}
    frames = [FoundFrame(p.stem, p, masks.get(p.stem)) for p in pictures]
    truth = [FoundFrame(p.stem, p) for p in pictures_in(root / "truth")] if folder != root else []
    ordered = all(any(c.isdigit() for c in p.stem) for p in pictures)
    return Found("photos", frames, truth, ordered)
