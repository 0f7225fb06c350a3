"""NeRF's synthetic scenes: transforms_train.json, transforms_test.json and transforms_val.json, one for each split."""

from dataclasses import replace
from pathlib import Path

from inpaint3d.stages.capture_ingest.found import Found, FoundFrame, SourceFiles, name_pictures, one_folder
from inpaint3d.stages.capture_ingest.nerfstudio import read_frames

FILE, TEST_FILE, VALIDATION_FILE = "transforms_train.json", "transforms_test.json", "transforms_val.json"


def find(root: Path, with_truth: bool) -> Found:
    """Frames of the training split; the test split as truth, where it is wanted and there."""
    files = SourceFiles(root)
    frames, notes = read_frames(files, FILE)
    truth: list[FoundFrame] = []
    if (root / TEST_FILE).is_file():
        if with_truth:
            truth, more = read_frames(files, TEST_FILE)
            notes += more
            notes.append(
                f"the {len(truth)} pictures of {TEST_FILE} are views to score against; where they show what is to be "
                "removed, set capture-ingest.blender_truth=false"
            )
        else:
            notes.append(f"{TEST_FILE} is left out, as capture-ingest.blender_truth asks")
    if (root / VALIDATION_FILE).is_file():
        notes.append(f"{VALIDATION_FILE} is left out")
    names = name_pictures([f.image for f in [*frames, *truth]])  # train/r_0 and test/r_0 are two views
    frames, truth = ([replace(f, name=names[f.image]) for f in views] for views in (frames, truth))
    return Found("blender", frames, truth, ordered=one_folder(frames), notes=notes + files.notes(FILE))
