"""SPIn-NeRF: `images_4/`, whose first 40 files show the scene without the object and the others with it."""

from pathlib import Path

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.capture_ingest import llff
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, masks_for, pictures_in

FOLDER = "images_4"


def find(root: Path, truth_count: int) -> Found:
    """Training frames with masks of `label/`, truth views with masks of `test_label/`, cameras of all in one file."""
    pictures = pictures_in(root / FOLDER)
    if len(pictures) < truth_count + 2:
        raise BadInputError(
            f"{FOLDER}/ holds {len(pictures)} pictures, but the first {truth_count} are the truth; "
            "set capture-ingest.spin_nerf_truth to how many there are"
        )
    cameras = llff.read_cameras(root, pictures)
    shown, taken = pictures[:truth_count], pictures[truth_count:]
    labels = masks_for(taken, root / FOLDER / "label")
    test_labels = masks_for(shown, root / FOLDER / "test_label")
    truth = [FoundFrame(p.stem, p, test_labels.get(p.stem), c) for p, c in zip(shown, cameras, strict=False)]
    frames = [FoundFrame(p.stem, p, labels.get(p.stem), c) for p, c in zip(taken, cameras[truth_count:], strict=True)]
    return Found("spin-nerf", frames, truth)
