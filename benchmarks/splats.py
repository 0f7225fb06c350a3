"""Splats of a run's scene against its held-out photos, beside the field that they began with.

    inpaint3d run examples/demo/capture --mask examples/demo/mask.yaml --name demo
    python -m benchmarks.splats --run runs/demo --pictures docs/pictures/splats.jpg

splat-export runs on the run's artifacts as a process of its own, on one thread. The field is rendered at the photos'
size and scored on the same pixels. Writes `benchmarks/results/splats.json`, the files to --files, and a picture of one
held-out photo, the field and the splats.
"""

# pxr ships no type stubs for its compiled modules.
# pyright: reportAttributeAccessIssue=false

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import yaml
from benchmarks.plates import Run
from benchmarks.provenance import REPOSITORY, commit
from numpy.typing import NDArray
from pxr import Usd, UsdVol

from inpaint3d.contracts.kit.upstream import invoke
from inpaint3d.contracts.models.artifacts import EffectPlan, MaskSet, PosedCapture, RadianceFieldArtifact, SplatScene
from inpaint3d.contracts.models.stage import load_stage
from inpaint3d.contracts.store import Artifact, FolderStore
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.radiance.splats import Splats, View, render_splats
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.masked_views import MaskedView, load_masked_scene
from inpaint3d.stages.splat_export.cloud import SH_DEGREE_0
from inpaint3d.stages.splat_export.fidelity import measure_fidelity

RESULTS = REPOSITORY / "benchmarks" / "results" / "splats.json"
Arrays = dict[str, NDArray[np.float64]]
PORTS = {
    "inpainted": ("joint-optimization", "radiance-field"),
    "posed-capture": ("pose-estimation", "posed-capture"),
    "effect-plan": ("scene-analysis", "effect-plan"),
    "mask-set": ("mask-authoring", "mask-set"),
    "completed-views": ("view-completion", "completed-views"),
}


def export(run: Run, store: FolderStore, parameters: dict[str, Any]) -> tuple[Artifact[SplatScene], dict[str, Any]]:
    """The stage's artifact, and what it took."""
    inputs = {port: run.outputs[node][output] for port, (node, output) in PORTS.items()}
    for digest in inputs.values():
        store.adopt(run.store.fetch(digest), run.store.manifest(digest))
    spec = load_stage(REPOSITORY / "stages/splat_export/stage.yaml")
    result = invoke(spec, store, inputs, parameters=parameters)
    if result.code != 0:
        raise RuntimeError(result.error)
    timings = next(iter(store.records())).timings
    cost = {"cpu_s": timings["cpu_s"], "peak_memory_mib": round(timings["peak_memory_bytes"] / 2**20)}
    return store.open(result.outputs["splat-scene"], SplatScene), cost


def load_photos(run: Run) -> list[MaskedView]:
    posed = run.open("pose-estimation", "posed-capture", PosedCapture)
    masks, plan = run.open("mask-authoring", "mask-set", MaskSet), run.open("scene-analysis", "effect-plan", EffectPlan)
    return list(load_masked_scene(posed, masks, plan, whole_mask=True).test)


def score_field(run: Run, photos: list[MaskedView]) -> tuple[dict[str, float], list[Image]]:
    """PSNR, SSIM and LPIPS of the field's renders at the photos' size, and the renders."""
    artifact = run.open("joint-optimization", "radiance-field", RadianceFieldArtifact)
    field = load_field(artifact.path(artifact.metadata.weights), artifact.metadata.spec).eval()
    pictures = {id(photo.camera): render_view(field, photo.camera)["rgb"] for photo in photos}
    fidelity = measure_fidelity(lambda camera: pictures[id(camera)], photos, None)
    figures = fidelity.model_dump(exclude={"photos", "field_psnr"}) if fidelity else {}
    return round_all(figures), [pictures[id(photo.camera)] for photo in photos]


def read_usd(path: Path) -> Arrays:
    """The arrays of a layer that splat-export wrote, z up."""
    stage = Usd.Stage.Open(str(path))
    prim = UsdVol.ParticleField3DGaussianSplat(stage.GetDefaultPrim().GetChild("Splats"))
    arrays = {
        "mean": prim.GetPositionsAttr(),
        "log_scale": prim.GetScalesAttr(),
        "alpha": prim.GetOpacitiesAttr(),
        "coefficients": prim.GetRadianceSphericalHarmonicsCoefficientsAttr(),
    }
    found = {name: np.array(attribute.Get(), np.float64) for name, attribute in arrays.items()}
    found["log_scale"] = np.log(found["log_scale"])
    found["rotation"] = np.array([(q.GetReal(), *q.GetImaginary()) for q in prim.GetOrientationsAttr().Get()])
    return found


def draw_usd(path: Path, camera: Camera) -> Image:
    """What the splats of a USD layer look like [h, w, 3]: drawn from the file, as anybody has it."""
    found = read_usd(path)
    alpha = found["alpha"].clip(1e-7, 1 - 1e-7)
    arrays = (
        found["mean"], found["log_scale"], found["rotation"], np.log(alpha / (1 - alpha)),
        0.5 + SH_DEGREE_0 * found["coefficients"],
    )  # fmt: skip
    splats = Splats(*(torch.from_numpy(np.ascontiguousarray(array, np.float32)) for array in arrays))
    return render_splats(splats, View.of(camera)).clamp(0, 1).numpy()


def write_picture(path: Path, photo: MaskedView, field: Image, splats: Image) -> None:
    """The photo with its hole grey, the field, the splats, side by side."""
    shown = np.where(photo.known[..., None], photo.image, np.float32(0.5))
    gap = np.ones((len(shown), 6, 3), np.float32)
    strip = np.concatenate([shown, gap, field, gap, splats], 1)
    cv2.imwrite(str(path), to_bytes(strip)[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])


def round_all(figures: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in figures.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, required=True)
    parser.add_argument("--store", type=Path, default=Path(".inpaint3d/store"))
    parser.add_argument("--set", default="{}", help="parameters of splat-export, as YAML")
    parser.add_argument("--files", type=Path, help="folder for the files that were written")
    parser.add_argument("--pictures", type=Path, help="JPEG to write: photo, field, splats")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    run = Run(asked.run, FolderStore(asked.store))
    photos = load_photos(run)
    with tempfile.TemporaryDirectory() as folder:
        scene, cost = export(run, FolderStore(Path(folder)), yaml.safe_load(asked.set))
        sizes = {one: (scene.root / file).stat().st_size for one, file in scene.metadata.files.items()}
        field, renders = score_field(run, photos)
        if asked.pictures:
            middle = len(photos) // 2
            splats = draw_usd(scene.path(scene.metadata.files["usdc"]), photos[middle].camera)
            write_picture(asked.pictures, photos[middle], renders[middle], splats)
        if asked.files:
            shutil.copytree(scene.root, asked.files, dirs_exist_ok=True)
    fidelity = scene.metadata.fidelity
    found = {
        "photos": len(photos),
        "splats": scene.metadata.splats,
        "of_the_splats": round_all(fidelity.model_dump(include={"psnr", "ssim", "lpips_vgg"})) if fidelity else {},
        "of_the_field": field,
        "bytes": sizes,
        **cost,
    }
    before = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    RESULTS.write_text(json.dumps(before | {"demo": commit() | found}, indent=1) + "\n")
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
