"""Objects pointed at with a few clicks against masks that are known: `make bench-masks [STATUE=FOLDER]`.

    python -m benchmarks.masks [--statue FOLDER] [--scenes SCENE ...] [--clicks N ...] [--work DIR]

Of each capture the pipeline is run up to nerf-pretraining (below --work; what is done is found there). Then the object
is pointed at on one view, and the masks that mask-authoring finds in all others are compared with the known ones (IoU),
without the growth that a request adds. Clicks are chosen without looking: the innermost points of so many equally high
slices of the known mask, which is what a person would aim at. Every fifth view is pointed at in turn, so that nothing
hangs on a lucky click; the demo's own request is a row of its own. CPU seconds are those of authoring, for all views
together. Rows that are not asked for stay as they were.

statue: a folder with images/, masks/ and cameras. The demo capture's masks are its renderer's. Writes
`benchmarks/results/masks.json`, its table beside it, and contact sheets below --work to be looked at.
"""

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from benchmarks.provenance import REPOSITORY, commit

from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import MaskRequest, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History, this_machine
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask, read_mask, write_png
from inpaint3d.stages.mask_authoring.author import author
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.scene import Scene, load_scene
from inpaint3d.stages.mask_authoring.segment import iou

RESULTS = REPOSITORY / "benchmarks" / "results" / "masks.json"
WORK = REPOSITORY / ".cache" / "bench-masks"
DEMO = REPOSITORY / "examples" / "demo"
EVERY = 5
SHEET = 12  # views on a contact sheet
FOUND, MISSED, TOO_MUCH = (0.1, 0.8, 0.2), (0.1, 0.3, 1.0), (1.0, 0.1, 0.1)


def say_nothing(event: str, **values: Any) -> None:
    """What a stage would report while it works."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A capture with the pretrained field, and the masks of its object at the posed frames' size."""

    scene: Scene
    truth: list[Mask]
    work: Path

    def measure(self, request: MaskRequest) -> tuple[dict[str, Any], list[Mask]]:
        """IoU of each view that was not pointed at, and the masks."""
        pointed = {prompts.view for prompts in request.mask.prompts}  # pyright: ignore[reportAttributeAccessIssue]
        ctx = Context(seed=0, device="cpu", threads=1, work=self.work, emit=say_nothing)
        start = time.process_time()
        made = author(request.mask, self.scene, 0.0, Config(), ctx)
        cpu_s = time.process_time() - start
        scores = [
            iou(mask, truth)
            for view, mask, truth in zip(self.scene.views, made.masks, self.truth, strict=True)
            if view.name not in pointed
        ]
        row = {"view": ", ".join(sorted(pointed)), "mean_iou": float(np.mean(scores)), "min_iou": min(scores)}
        return row | {"views": len(scores), "cpu_s": cpu_s}, made.masks


def prepare(name: str, capture: Path, work: Path) -> tuple[PosedCapture, Scene]:
    """The capture's posed views and pretrained field, made where they are not there yet."""
    command = [
        str(Path(sys.executable).parent / "inpaint3d"), "run", str(capture), "--name", name, "--until",
        "nerf-pretraining", "--store", str(work / "store"), "--runs-dir", str(work / "runs"),
    ]  # fmt: skip
    subprocess.run(command, cwd=REPOSITORY, check=True)
    store = FolderStore(work / "store")
    outputs = {node.node: node.outputs for node in History(store).latest(name).nodes}
    posed = store.open(outputs["pose-estimation"]["posed-capture"], PosedCapture)
    field = store.open(outputs["nerf-pretraining"]["radiance-field"], RadianceFieldArtifact)
    return posed.metadata, load_scene(posed, field)


def prepare_statue(folder: Path, work: Path) -> Bench:
    """Masks that came with the capture; only their pictures' size differs."""
    _, scene = prepare("statue", folder, work)
    masks = [view.mask() for view in scene.views]
    if missing := [v.name for v, m in zip(scene.views, masks, strict=True) if m is None]:
        raise SystemExit(f"{folder}: no mask for view {missing[0]}; the statue's folder has masks/ beside images/")
    return Bench(scene, [m for m in masks if m is not None], work)


def prepare_demo(work: Path) -> Bench:
    """The renderer's masks, which lie in the distorted pictures, taken to the posed frames."""
    posed, scene = prepare("demo", DEMO / "capture", work)
    folder = DEMO / "renderer" / "masks"
    bend = posed.lens.params[3] if posed.lens.model == "SIMPLE_RADIAL" else 0.0
    return Bench(scene, [undistort(read_mask(folder / f"{v.name}.png"), v.camera, bend) for v in scene.views], work)


def undistort(mask: Mask, camera: Camera, bend: float) -> Mask:
    """A mask [h, w] seen through a lens with COLMAP's k, at the pinhole's pixels."""
    plane = (camera.pixel_centres() - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    bent = plane * (1 + bend * np.sum(plane**2, -1, keepdims=True))
    scale = np.array(mask.shape[::-1]) / (camera.width, camera.height)
    xy = np.floor((bent * (camera.fx, camera.fy) + (camera.cx, camera.cy)) * scale).astype(int)
    return mask[xy[..., 1].clip(0, mask.shape[0] - 1), xy[..., 0].clip(0, mask.shape[1] - 1)]


def choose_clicks(mask: Mask, count: int) -> list[tuple[float, float]]:
    """The innermost pixel of each of `count` slices of a mask, from top to bottom."""
    rows = np.flatnonzero(mask.any(1))
    clicks: list[tuple[float, float]] = []
    for slice_ in np.array_split(rows, count):
        part = np.zeros_like(mask)
        part[slice_] = mask[slice_]
        depth = cv2.distanceTransform(np.pad(part, 1).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
        row, column = np.unravel_index(int(np.argmax(depth)), depth.shape)
        clicks.append((float(column) + 0.5, float(row) + 0.5))
    return clicks


def point_in_turn(bench: Bench, clicks: int) -> list[dict[str, Any]]:
    """Every fifth view pointed at in turn."""
    rows: list[dict[str, Any]] = []
    for view, truth in list(zip(bench.scene.views, bench.truth, strict=True))[::EVERY]:
        mask = {"kind": "object", "view": view.name, "points": choose_clicks(truth, clicks)}
        row, _ = bench.measure(MaskRequest.model_validate({"mask": mask, "dilate": 0}))
        rows.append(row)
        print(json.dumps(row), flush=True)
    return rows


def measure_own(bench: Bench, request: MaskRequest, sheet: Path) -> dict[str, Any]:
    """One request, and a contact sheet of what it finds."""
    row, masks = bench.measure(request)
    draw_sheet(bench, masks, sheet)
    print(json.dumps(row), flush=True)
    return row


def draw_sheet(bench: Bench, masks: Sequence[Mask], path: Path) -> None:
    """Views with what was found (green), missed (blue) and taken wrongly (red)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    tiles = []
    for i in np.linspace(0, len(masks) - 1, SHEET).round().astype(int):
        picture = bench.scene.views[i].image().copy()
        mask, truth = masks[i], bench.truth[i]
        for where, colour in ((mask & truth, FOUND), (~mask & truth, MISSED), (mask & ~truth, TOO_MUCH)):
            picture[where] = 0.5 * picture[where] + 0.5 * np.array(colour, np.float32)
        tiles.append(picture)
    rows = [np.concatenate(tiles[i : i + 4], 1) for i in range(0, SHEET, 4)]
    write_png(path, np.concatenate(rows, 0))


def write_table(results: dict[str, Any]) -> str:
    """One row for each capture and number of clicks."""
    lines = [
        "| capture | clicks on one view | views pointed at | other views: mean IoU | worst of these means "
        "| worst mask | CPU seconds, all views |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, rows in results["rows"].items():
        capture, clicks = name.split(", ")
        mean, cpu = (float(np.mean([r[k] for r in rows])) for k in ("mean_iou", "cpu_s"))
        worst, mask = (min(r[k] for r in rows) for k in ("mean_iou", "min_iou"))
        lines.append(f"| {capture} | {clicks} | {len(rows)} | {mean:.3f} | {worst:.3f} | {mask:.3f} | {cpu:.1f} |")
    return "\n".join([f"{results['processor']}, one thread.", "", *lines, ""])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--statue", type=Path, help="29 photos of a statue, with masks and cameras")
    parser.add_argument("--scenes", nargs="*", choices=("demo", "statue"), default=("demo", "statue"))
    parser.add_argument("--clicks", nargs="*", type=int, default=(1, 2, 3))
    parser.add_argument("--work", type=Path, default=WORK)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    results: dict[str, Any] = json.loads(RESULTS.read_text()) if RESULTS.exists() else {"rows": {}}
    results |= {"code": commit(), "processor": this_machine().processor}
    rows: dict[str, list[dict[str, Any]]] = results["rows"]
    if "demo" in options.scenes:
        demo, (request, _) = prepare_demo(options.work), load_document(DEMO / "mask.yaml", MaskRequest)
        rows["demo, its mask.yaml"] = [measure_own(demo, request, options.work / "sheets" / "demo.png")]
        rows |= {f"demo, {n}": point_in_turn(demo, n) for n in options.clicks}
    if "statue" in options.scenes and options.statue is not None:
        statue = prepare_statue(options.statue, options.work)
        rows |= {f"statue, {n}": point_in_turn(statue, n) for n in options.clicks}
    results["rows"] = dict(sorted(rows.items()))
    RESULTS.write_text(json.dumps(results, indent=1) + "\n")
    table = write_table(results)
    RESULTS.with_suffix(".md").write_text(table)
    print(table)


if __name__ == "__main__":
    main()
