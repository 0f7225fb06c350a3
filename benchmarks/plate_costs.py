"""What plates cost: `python -m benchmarks.plate_costs --run runs/demo --size 1 50 --size 24 4`.

The photos of a run are enlarged to so many megapixels, the first so many of them, and plate-export runs on them as a
process of its own, on one thread. Adds to `benchmarks/results/plates.json`.
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks.plates import REPOSITORY, RESULTS, Run

from inpaint3d.contracts.kit.upstream import invoke
from inpaint3d.contracts.models.artifacts import Capture, CompletedViews, PosedCapture
from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import Artifact, FolderStore
from inpaint3d.scene.capture_io import SparsePoints, load_points, write_points
from inpaint3d.scene.image_io import read_image, write_png
from inpaint3d.scene.map_io import read_codes, write_codes


def measure_size(run: Run, megapixels: float, count: int) -> dict[str, Any]:
    """CPU seconds and peak memory of the plates of `count` photos, enlarged."""
    capture = run.open("capture-ingest", "capture", Capture)
    posed = run.open("pose-estimation", "posed-capture", PosedCapture)
    completed = run.open("view-completion", "completed-views", CompletedViews)
    seen = {v.name for v in completed.metadata.views}
    kept = {f.name for f in sorted(posed.metadata.frames, key=lambda f: f.name not in seen)[:count]}
    first = capture.metadata.frames[0]
    factor = (megapixels * 1e6 / (first.width * first.height)) ** 0.5
    with tempfile.TemporaryDirectory() as folder:
        store = FolderStore(Path(folder))
        masks = run.outputs["mask-authoring"]["mask-set"]
        store.adopt(run.store.fetch(masks), run.store.manifest(masks))
        inputs = {
            "mask-set": masks,
            "capture": put_enlarged(store, capture, kept, factor),
            "posed-capture": put_posed(store, posed, kept, factor),
            "completed-views": put_part(
                store,
                "completed-views",
                completed,
                views=tuple(v for v in completed.metadata.views if v.name in kept),
                reference_views=tuple(n for n in completed.metadata.reference_views if n in kept),
            ),
        }
        result = invoke(load_stage(REPOSITORY / "stages/plate_export/stage.yaml"), store, inputs)
        if result.code != 0:
            raise RuntimeError(result.error)
        timings = next(iter(store.records())).timings
    return {"cpu_s": timings["cpu_s"], "peak_memory_mib": round(timings["peak_memory_bytes"] / 2**20)}


def put_enlarged(store: FolderStore, capture: Artifact[Capture], kept: set[str], factor: float) -> Digest:
    folder = store.private_folder()
    frames = []
    for frame in (f for f in capture.metadata.frames if f.name in kept):
        size = (round(frame.width * factor), round(frame.height * factor))
        picture = cv2.resize(read_image(capture.path(frame.path)), size, interpolation=cv2.INTER_CUBIC)
        path = f"frames/{frame.name}.png"
        write_png(folder / path, picture.clip(0, 1))
        frames.append(frame.model_copy(update={"path": path, "width": size[0], "height": size[1], "original": None}))
    return store.put(folder, "capture", capture.metadata.model_copy(update={"frames": tuple(frames)}))


def put_posed(store: FolderStore, posed: Artifact[PosedCapture], kept: set[str], factor: float) -> Digest:
    """The kept frames, their lens at the enlarged size, and of the points' tracks what they saw."""
    numbers = [i for i, f in enumerate(posed.metadata.frames) if f.name in kept]
    points = keep_frames(load_points(posed.path(posed.metadata.points)), numbers)
    lens = posed.metadata.lens
    # Of SIMPLE_RADIAL, which the demo's lens is: focal length and centre scale, distortion does not.
    params = (*(p * factor for p in lens.params[:3]), *lens.params[3:])
    return put_part(
        store,
        "posed-capture",
        posed,
        points,
        frames=tuple(posed.metadata.frames[i] for i in numbers),
        lens=lens.model_copy(update={"params": params}),
    )


def put_part(
    store: FolderStore, name: str, artifact: Artifact[Any], points: SparsePoints | None = None, **update: Any
) -> Digest:
    """An artifact with other metadata, and what of its files that still names."""
    folder = store.private_folder()
    metadata: Closed = artifact.metadata.model_copy(update=update)
    shutil.copytree(artifact.root, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("artifact.json"))
    if points is not None:
        (folder / "points.safetensors").unlink()
        write_points(folder / "points.safetensors", points)
    for path in (folder / "sources").glob("*.png"):
        codes = read_codes(path)
        # Photos that are left out have no number: which one stands here decides nothing.
        path.unlink()
        write_codes(path, np.minimum(codes, FIRST_PHOTO))
    named = metadata.model_dump_json()
    for path in [p for p in folder.rglob("*") if p.is_file() and str(p.relative_to(folder)) not in named]:
        path.unlink()
    return store.put(folder, name, metadata)


def keep_frames(points: SparsePoints, numbers: list[int]) -> SparsePoints:
    """The points with what the frames of these numbers saw of them; frames are counted anew."""
    place = {old: new for new, old in enumerate(numbers)}
    rows = np.isin(points.track_frame, numbers)
    lengths = np.bincount(points.track_point[rows], minlength=len(points))
    return SparsePoints(
        points.xyz,
        points.rgb,
        points.error,
        np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        np.array([place[f] for f in points.track_frame[rows].tolist()], np.int32),
        points.track_xy[rows],
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--store", type=Path, default=Path(".inpaint3d/store"))
    parser.add_argument("--size", nargs=2, action="append", metavar=("MEGAPIXELS", "PHOTOS"), required=True)
    options = parser.parse_args()
    run = Run(options.run, FolderStore(options.store))
    for megapixels, count in options.size:
        cost = measure_size(run, float(megapixels), int(count))
        print(megapixels, count, cost, flush=True)
        results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
        results.setdefault("costs", {})[f"{count} photos of {megapixels} MP"] = cost
        RESULTS.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
