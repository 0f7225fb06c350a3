"""What usd-export makes of finished runs: `make bench-usd RUNS="NAME ..." [BLENDER=PYTHON]`.

    python -m benchmarks.usd NAME [NAME ...] [--store FOLDER] [--blender PYTHON]

Of each run's newest record the artifacts are taken that usd-export reads, and the stage is run on them anew, in one
thread. The mesh's scores are those of the stage: renders against the photographs held out, outside the mask. LPIPS is
of the whole photographs, with the mask's pixels taken from them; the mesh is the one in the usdz. Writes
`benchmarks/results/usd.json` and its table beside it; rows of other runs stay as they were. blender: a Python that has
`bpy` (5.0 was used; an environment of its own), which renders two views of the usdz into --work, to be looked at beside
the photos.
"""

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from benchmarks.provenance import REPOSITORY, commit
from pxr import Usd, UsdGeom

from inpaint3d.contracts.kit.shim import Invocation, execute
from inpaint3d.contracts.models.artifacts import MaskSet, PosedCapture, RadianceFieldArtifact, UsdScene
from inpaint3d.contracts.store import Artifact, FolderStore
from inpaint3d.perception.lpips import load as load_lpips
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.scene.capture_io import load_posed
from inpaint3d.scene.image_io import read_image
from inpaint3d.stages.usd_export.fidelity import render_mesh
from inpaint3d.stages.usd_export.pictures import load_held_out, load_masks
from inpaint3d.stages.usd_export.rays import Caster

RESULTS = REPOSITORY / "benchmarks" / "results" / "usd.json"
COLUMNS = {
    "scene": "scene", "psnr": "PSNR of the mesh, dB", "field_psnr": "of the field", "ssim": "SSIM of the mesh",
    "lpips": "LPIPS of the mesh", "field_lpips": "of the field", "photos": "photos", "triangles": "triangles",
    "charts": "charts", "texel_use": "texels used", "collision_pieces": "convex pieces", "usdz_mib": "usdz, MiB",
    "glb_mib": "GLB, MiB", "validation_errors": "validation errors", "cpu_s": "CPU s",
}  # fmt: skip


def main() -> None:
    """Measure the runs that were named, and write the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.usd")
    parser.add_argument("names", nargs="+", help="runs in the store")
    parser.add_argument("--store", type=Path, default=REPOSITORY / ".cache" / "store")
    parser.add_argument("--work", type=Path, default=REPOSITORY / ".cache" / "bench-usd")
    parser.add_argument("--blender", type=Path, help="a Python that has bpy")
    asked = parser.parse_args()
    rows = {row["scene"]: row for row in json.loads(RESULTS.read_text())["rows"]} if RESULTS.exists() else {}
    for name in asked.names:
        row, scene = measure(FolderStore(asked.store), name)
        rows[name] = row
        if asked.blender:
            render(asked.blender, scene, asked.work / name)
    document = {**commit(), "rows": [rows[name] for name in sorted(rows)]}
    RESULTS.write_text(json.dumps(document, indent=1) + "\n")
    RESULTS.with_suffix(".md").write_text(make_table(document["rows"]))


def measure(store: FolderStore, name: str) -> tuple[dict[str, Any], Path]:
    """The stage on a run's artifacts: a row of the table, and where the usdz lies."""
    inputs = find_inputs(store, name)
    record = execute("inpaint3d.stages.usd_export", store, Invocation(inputs=inputs, threads=1), sys.stderr)
    artifact = store.open(record.outputs["usd-scene"], UsdScene)
    made = artifact.metadata
    row: dict[str, Any] = {"scene": name, **(made.fidelity.model_dump() if made.fidelity else {})}
    row |= {key: getattr(made, key) for key in COLUMNS if key in UsdScene.model_fields}
    package = artifact.path(made.package)
    row["usdz_mib"] = round(package.stat().st_size / 2**20, 2)
    row["glb_mib"] = round(artifact.path(made.models[0]).stat().st_size / 2**20, 2)
    return row | measure_lpips(store, inputs, artifact) | {"cpu_s": round(record.timings["cpu_s"], 1)}, package


def measure_lpips(store: FolderStore, inputs: dict[str, Any], made: Artifact[UsdScene]) -> dict[str, float]:
    """Of the mesh in the layer and of the field, on the photographs held out, means."""
    posed, masks = store.open(inputs["posed-capture"], PosedCapture), store.open(inputs["mask-set"], MaskSet)
    trained = store.open(inputs["inpainted"], RadianceFieldArtifact)
    field = load_field(trained.path(trained.metadata.weights), trained.metadata.spec)
    views = load_posed(posed)
    stage = Usd.Stage.Open(str(made.path(made.metadata.layer)))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Surface"))
    caster = Caster(
        np.asarray(mesh.GetPointsAttr().Get()), np.asarray(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    )
    coordinates = np.asarray(UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st").Get(), np.float32).reshape(-1, 3, 2)
    texture, lpips = read_image(made.path(made.metadata.textures[0])), load_lpips("vgg")
    scores: list[tuple[float, float]] = []
    for photo in load_held_out(views, load_masks(masks, views)):
        shown = render_mesh(caster, coordinates, texture, photo.camera), render_view(field, photo.camera)["rgb"]
        whole = [np.where(photo.known[..., None], picture, photo.image) for picture in shown]
        scores.append((lpips.distance(whole[0], photo.image), lpips.distance(whole[1], photo.image)))
    if not scores:
        return {}
    return dict(zip(("lpips", "field_lpips"), np.round(np.mean(scores, 0), 4).tolist(), strict=True))


def find_inputs(store: FolderStore, name: str) -> dict[str, Any]:
    """Digests at usd-export's ports, as the run's newest record has them. SystemExit where there is no such run."""
    records = sorted((store.root / "runs" / name).glob("*.json"))
    if not records:
        raise SystemExit(f"the store {store.root} has no run {name}; inpaint3d runs lists them")
    nodes = {node["node"]: node for node in json.loads(records[-1].read_text())["nodes"]}
    stages = yaml.safe_load((REPOSITORY / "pipeline.yaml").read_text())["spec"]["stages"]
    wired = next(stage for stage in stages if stage["name"] == "usd-export")["inputs"]
    found: dict[str, Any] = {}
    for port, source in wired.items():
        node, _, output = str(source).partition(".")
        if digest := nodes.get(node, {}).get("outputs", {}).get(output):
            found[port] = digest
    return found


def render(python: Path, scene: Path, out: Path) -> None:
    """Two views by Blender, in an environment of its own."""
    out.mkdir(parents=True, exist_ok=True)
    script = REPOSITORY / "benchmarks" / "usd" / "blender.py"
    subprocess.run([str(python), str(script), str(scene), str(out), "View_0010", "View_0020"], check=True)


def make_table(rows: list[dict[str, Any]]) -> str:
    """The rows as Markdown."""
    lines = [" | ".join(COLUMNS.values()), " | ".join("---" for _ in COLUMNS)]
    lines += [" | ".join(_format(row.get(key)) for key in COLUMNS) for row in rows]
    return "".join(f"| {line} |\n" for line in lines)


def _format(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    main()
