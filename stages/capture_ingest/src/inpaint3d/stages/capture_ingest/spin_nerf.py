"""SPIn-NeRF: `images_4/`, whose first 40 files show the scene without the object and the others with it."""

from pathlib import Path

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.capture_ingest import llff
from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, masks_for, name_pictures, pictures_in

FOLDER = "images_4"
LABELS, TEST_LABELS = "label", "test_label"


def find(root: Path, truth_count: int) -> Found:
    """Training frames with masks of `label/`, truth views with masks of `test_label/`, cameras of all in one file."""
    pictures = pictures_in(root / FOLDER)
    if len(pictures) < truth_count + 2:
        raise BadInputError(
            f"{FOLDER}/ holds {len(pictures)} pictures, but the first {truth_count} are the truth; "
            "set capture-ingest.spin_nerf_truth to how many there are"
        )
    cameras = llff.read_cameras(root, pictures)
    names = name_pictures(pictures)
    notes = llff.describe_order(pictures, cameras)

    def views(chosen: list[Path], labels: str) -> list[FoundFrame]:
        masks = _match_labels(chosen, root / FOLDER / labels, notes)
        return [FoundFrame(names[p], p, masks.get(p), *cameras[p]) for p in chosen]

    truth, frames = views(pictures[:truth_count], TEST_LABELS), views(pictures[truth_count:], LABELS)
    return Found("spin-nerf", frames, truth, notes=notes)


def _match_labels(pictures: list[Path], folder: Path, notes: list[str]) -> dict[Path, Path]:
    """Masks by name, or by order where not one name fits and there are as many."""
    labels = pictures_in(folder)
    stems = {p.stem for p in pictures} | {p.name for p in pictures}
    if labels and len(labels) == len(pictures) and not any(mask.stem in stems for mask in labels):
        notes.append(f"{folder.name}/: no mask has the name of a picture; all {len(labels)} are taken in order")
        return dict(zip(pictures, labels, strict=True))
    return masks_for(pictures, folder)
