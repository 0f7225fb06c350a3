"""Clean plates of the demo capture against the renderer's truth at the photos' own cameras.

    python examples/demo/render.py --clean --out FOLDER                 # the truth: renderer/clean
    inpaint3d run examples/demo/capture --mask examples/demo/mask.yaml --name demo --want plate-export
    python -m benchmarks.plates --run runs/demo --clean FOLDER/renderer/clean

What painting is worth: the truth of one view, painted, in the plates of the others.

    inpaint3d paint ask demo --out to-paint
    python -m benchmarks.plates --run runs/demo --clean FOLDER/renderer/clean --paint to-paint
    inpaint3d run ... --name painted --want plate-export --painted to-paint
    python -m benchmarks.plates --run runs/demo --clean FOLDER/renderer/clean --painted runs/painted

Writes `benchmarks/results/plates.json`. The field's render is that of `joint-optimization` at the posed frames' size,
enlarged to the photo's, its colours brought to the photo's by a gain and an offset for each channel on known pixels.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.provenance import commit

from inpaint3d.contracts.models.artifacts import (
    Capture,
    CleanPlates,
    CompletedViews,
    PosedCapture,
    RadianceFieldArtifact,
)
from inpaint3d.contracts.store import FolderStore
from inpaint3d.perception.lpips import load as load_lpips
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import read_image, read_mask, write_png
from inpaint3d.scene.psnr import psnr
from inpaint3d.stages.plate_export.lens import Box, PhotoCamera
from inpaint3d.stages.plate_export.photos import sample_cubic

REPOSITORY = Path(__file__).resolve().parents[1]
RESULTS = REPOSITORY / "benchmarks" / "results" / "plates.json"
MARGIN = 4  # pixels of the box around a hole


class Run:
    """A run's artifacts, by its `metrics.json`."""

    def __init__(self, folder: Path, store: FolderStore) -> None:
        stages = json.loads((folder / "metrics.json").read_text())["stages"]
        self.outputs = {s["node"]: s["outputs"] for s in stages}
        self.figures = {s["node"]: s for s in stages}
        self.store = store

    def open(self, node: str, port: str, model: type) -> Any:
        return self.store.open(self.outputs[node][port], model)


def find_box(mask: np.ndarray) -> tuple[slice, slice]:
    spans = (np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0)))
    rows, columns = (slice(max(0, s[0] - MARGIN), s[-1] + 1 + MARGIN) for s in spans)
    return rows, columns


def render_enlarged(field: Any, camera: PhotoCamera, box: tuple[slice, slice], photo: np.ndarray, known: np.ndarray):
    """The field's render in a box of the photo, lens and exposure as the photo has them."""
    rows, columns = box
    rays = camera.rays(Box(columns.start, rows.start, columns.stop, rows.stop))
    posed = camera.to_posed(rays)
    x0, y0 = (max(0, int(posed[..., i].min()) - 3) for i in (0, 1))
    width, height = int(posed[..., 0].max()) + 4 - x0, int(posed[..., 1].max()) + 4 - y0
    p = camera.posed
    crop = Camera(p.fx, p.fy, p.cx - x0, p.cy - y0, width, height, p.world_from_cam)
    seen = render_view(field, crop)["rgb"]
    made = sample_cubic(seen, (posed - (x0, y0)).reshape(-1, 2)).reshape(*posed.shape[:2], 3).clip(0, 1)
    there, wanted = made[known[box]], photo[box][known[box]]
    lines = [np.polyfit(there[:, c], wanted[:, c], 1) for c in range(3)]
    return np.stack([np.polyval(lines[c], made[..., c]) for c in range(3)], -1).clip(0, 1).astype(np.float32)


def measure_plates(run: Run, clean: Path) -> dict[str, Any]:
    """Plates and renders against the truth; how many known pixels differ from the photo's; the plates' own figures."""
    capture = run.open("capture-ingest", "capture", Capture)
    posed = run.open("pose-estimation", "posed-capture", PosedCapture)
    plates = run.open("plate-export", "clean-plates", CleanPlates)
    artifact = run.open("joint-optimization", "radiance-field", RadianceFieldArtifact)
    field = load_field(artifact.path(artifact.metadata.weights), artifact.metadata.spec)
    lpips = load_lpips("vgg")
    frames = {f.name: f for f in capture.metadata.frames}
    records = {p.name: p for p in plates.metadata.plates}
    rows: list[dict[str, Any]] = []
    changed = 0
    for frame in posed.metadata.frames:
        photo = read_image(capture.path(frames[frame.name].path))
        plate = read_image(plates.path(records[frame.name].picture))
        mask = read_mask(plates.path(records[frame.name].mask))
        changed += int((photo != plate).any(-1)[~mask].sum())
        if not (clean / f"{frame.name}.png").exists():
            continue
        truth = read_image(clean / f"{frame.name}.png")
        camera = PhotoCamera.from_frame(frame, posed.metadata.lens, photo.shape[1], photo.shape[0])
        box = find_box(mask)
        render = render_enlarged(field, camera, box, photo, ~mask)
        composed = np.where(mask[box][..., None], render, photo[box])
        row: dict[str, Any] = {"view": frame.name, "split": frame.split}
        for name, picture in (("plate", plate[box]), ("render", render), ("render, photo around it", composed)):
            row[name] = {
                "psnr": psnr(picture, truth[box]),
                "psnr_hole": psnr(picture, truth[box], mask[box]),
                "lpips": lpips.distance(picture, truth[box]),
            }
        rows.append(row)
        print(json.dumps(row), flush=True)
    consistency = plates.metadata.consistency
    return {
        "views": rows,
        "mean": average(rows, ("plate", "render", "render, photo around it")),
        "known_pixels_changed": changed,
        "consistency": None if consistency is None else consistency.model_dump(),
        "cpu_s": run.figures["plate-export"].get("cpu_s"),
        "peak_memory_bytes": run.figures["plate-export"].get("peak_memory_bytes"),
    }


def average(rows: list[dict[str, Any]], names: tuple[str, ...]) -> dict[str, dict[str, float]]:
    return {n: {m: float(np.mean([r[n][m] for r in rows])) for m in rows[0][n]} for n in names}


def paint_truth(run: Run, folder: Path, clean: Path) -> None:
    """Paint the truth of the first view that was asked for (`inpaint3d paint ask`) inside its mask; of no other."""
    posed = run.open("pose-estimation", "posed-capture", PosedCapture)
    names = [frame.name for frame in posed.metadata.frames if (folder / "asked" / f"{frame.name}.png").exists()]
    by = names[0]
    for name in names[1:]:
        (folder / f"{name}.png").unlink(missing_ok=True)
    frame = next(frame for frame in posed.metadata.frames if frame.name == by)
    if not (clean / f"{by}.png").exists():
        raise SystemExit(f"{clean} has no {by}.png; render it: examples/demo/render.py --clean --only {by}")
    asked, mask = read_image(folder / "asked" / f"{by}.png"), read_mask(folder / "masks" / f"{by}.png")
    shown = read_image(clean / f"{by}.png")
    camera = PhotoCamera.from_frame(frame, posed.metadata.lens, shown.shape[1], shown.shape[0])
    canvas = camera.canvas
    rays = (canvas.pixel_centres() - (canvas.cx, canvas.cy)) / (canvas.fx, canvas.fy)
    truth = sample_cubic(shown, camera.project(rays).reshape(-1, 2)).reshape(asked.shape)
    write_png(folder / f"{by}.png", np.where(mask[..., None], truth, asked).clip(0, 1).astype(np.float32))
    print(f"painted {by} in {folder}")


def measure_painted(before: Run, after: Run, clean: Path) -> dict[str, Any]:
    """The unpainted run's plates and those of the painted one against the truth, in every view but the painted one."""
    lpips = load_lpips("vgg")
    completed = after.open("view-completion", "completed-views", CompletedViews)
    by = completed.metadata.paintings[0].name
    rows: list[dict[str, Any]] = []
    opened = {n: r.open("plate-export", "clean-plates", CleanPlates) for n, r in (("before", before), ("after", after))}
    for record in opened["before"].metadata.plates:
        if record.name == by or not (clean / f"{record.name}.png").exists():
            continue
        mask = read_mask(opened["before"].path(record.mask))
        box, truth = find_box(mask), read_image(clean / f"{record.name}.png")
        row: dict[str, Any] = {"view": record.name}
        for name, plates in opened.items():
            picture = read_image(plates.path(next(p for p in plates.metadata.plates if p.name == record.name).picture))
            row[name] = {
                "psnr_hole": psnr(picture, truth, mask),
                "lpips": lpips.distance(picture[box], truth[box]),
            }
        rows.append(row)
        print(json.dumps(row), flush=True)
    return {
        "painted": by,
        "views": rows,
        "mean": average(rows, ("before", "after")),
        "paintings": [p.model_dump() for p in completed.metadata.paintings],
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--clean", type=Path, required=True, help="folder of the truth at the photos' cameras")
    parser.add_argument("--store", type=Path, default=Path(".inpaint3d/store"))
    parser.add_argument("--paint", type=Path, help="folder of `inpaint3d paint ask` to paint the truth into; no more")
    parser.add_argument("--painted", type=Path, help="the run of the same capture with what was painted")
    options = parser.parse_args()
    store = FolderStore(options.store)
    run = Run(options.run, store)
    if options.paint is not None:
        paint_truth(run, options.paint, options.clean)
        return
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    results |= {"code": commit(), "plates": measure_plates(run, options.clean)}
    if options.painted is not None:
        results["painted"] = measure_painted(run, Run(options.painted, store), options.clean)
    RESULTS.write_text(json.dumps(results, indent=1) + "\n")


if __name__ == "__main__":
    main()
