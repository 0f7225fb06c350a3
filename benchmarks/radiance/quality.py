"""How well fields show views that they were not fitted to: `make bench-radiance-quality SCENES="NAME=FOLDER ..."`.

    python -m benchmarks.radiance.quality [NAME=FOLDER ...] [--preset PRESET] [--out FILE]

Takes the demo capture and each FOLDER of photos (or with transforms.json) through the pipeline as far as
nerf-pretraining, and scores its field on whole held-out photos: PSNR, SSIM, LPIPS (VGG), means over views, mean
appearance code. Beside them what the stage says of depth at the sparse points (`depth_error`, `floaters`) and the CPU
seconds it took. Writes `benchmarks/results/radiance_quality.json`, where scenes that are not named stay as they were,
and prints its table.
"""

import argparse
import json
import statistics
from pathlib import Path
from typing import Any

import numpy as np
from benchmarks.provenance import REPOSITORY, commit
from benchmarks.radiance import scene as scenes

from inpaint3d.contracts.models.artifacts import PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import this_machine
from inpaint3d.perception import lpips
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.capture_io import load_posed
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.ssim import ssim

RESULTS = REPOSITORY / "benchmarks" / "results" / "radiance_quality.json"
DEMO = REPOSITORY / "examples" / "demo" / "capture"
COLUMNS = {"psnr": ".2f", "ssim": ".3f", "lpips_vgg": ".3f", "depth_error": ".4f", "floaters": ".3f", "cpu_s": ".0f"}


def measure(capture: Path, folder: Path, preset: str) -> dict[str, Any]:
    """Run the stages over a capture and score what they made."""
    scenes.run_until("nerf-pretraining", capture, REPOSITORY, folder, preset=preset)
    stages = scenes.stages(folder)
    store, took = FolderStore(folder / "store"), stages["nerf-pretraining"]
    artifact = store.open(took["outputs"]["radiance-field"], RadianceFieldArtifact)
    record = store.lookup(took["key"])
    if record is None:
        raise SystemExit(f"{folder} left no record of {took['key']}; remove it and run again")
    field = load_field(artifact.path(artifact.metadata.weights), artifact.metadata.spec).eval()
    posed = store.open(stages["pose-estimation"]["outputs"]["posed-capture"], PosedCapture)
    scores: list[tuple[float, float, float]] = []
    held_out = [view for view in load_posed(posed) if view.split == "test"]
    if not held_out:
        raise SystemExit(f"{capture} gave no held-out view; take one with more photos")
    for view in held_out:
        truth, valid = view.image(), view.valid()
        # What the photo does not show counts as shown right.
        picture = np.where(valid[..., None], render_view(field, view.camera)["rgb"], truth)
        scores.append((psnr(picture, truth, valid), ssim(picture, truth), lpips.load("vgg").distance(picture, truth)))
    means = dict(zip(("psnr", "ssim", "lpips_vgg"), map(statistics.fmean, zip(*scores, strict=True)), strict=True))
    return {
        **commit(),
        "preset": preset,
        "held_out": [view.name for view in held_out],
        "size": [held_out[0].camera.width, held_out[0].camera.height],
        **means,
        "depth_error": artifact.metadata.depth_error,
        "floaters": artifact.metadata.floaters,
        "cpu_s": record.timings["cpu_s"],
    }


def table(measured: dict[str, dict[str, Any]]) -> str:
    lines = [f"| scene | preset | held-out views | {' | '.join(COLUMNS)} |", "|---" * (3 + len(COLUMNS)) + "|"]
    for name, figures in measured.items():
        cells = [format(figures[column], form) for column, form in COLUMNS.items()]
        lines.append(f"| {name} | {figures['preset']} | {len(figures['held_out'])} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", metavar="NAME=FOLDER")
    parser.add_argument("--preset", default="standard", help="of pipeline.yaml")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--work", type=Path, default=REPOSITORY / ".cache" / "radiance-quality", help="stores and runs")
    options = parser.parse_args()
    captures = {"demo": DEMO}
    for named in options.scenes:
        name, equals, folder = named.partition("=")
        if not equals or not Path(folder).is_dir():
            parser.error(f"{named!r} is not NAME=FOLDER of a folder that exists")
        captures[name] = Path(folder)
    result = json.loads(options.out.read_text()) if options.out.exists() else {"measured": {}}
    for name, capture in captures.items():
        result["measured"][name] = measure(capture, options.work.resolve() / name, options.preset)
        result["machine"] = this_machine().model_dump()
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(json.dumps(result, indent=1) + "\n")
    print(table(result["measured"]))


if __name__ == "__main__":
    main()
