"""What a run leaves where a person looks: report.html, scene.usdz, metrics.json, pictures/, plates/ in `runs/NAME/`."""

import json
import shutil
from pathlib import Path
from typing import Any

from inpaint3d.contracts.models.artifacts import CleanPlates, Evaluation, UsdScene
from inpaint3d.contracts.models.report import AccuracyCourse, EffectFigures, RunRecord, RunReport, StageFigures
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.accuracy import follow_accuracy
from inpaint3d.orchestrator.effects import read_effects
from inpaint3d.orchestrator.pages.report import render_report

REPORT = "report.html"


def publish(store: Store, record: RunRecord, folder: Path) -> RunReport:
    """Write the results of a run, replacing what an earlier run of the name left. Returns what metrics.json says.

    What the run has no result for goes: nothing of an earlier run lies beside the report of this one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    outputs = {n.node: n.outputs for n in record.nodes}
    protocols: tuple[Any, ...] = ()
    course = follow_accuracy(store, record)
    if digest := outputs.get("evaluation", {}).get("evaluation"):
        artifact = store.open(digest, Evaluation)
        protocols = artifact.metadata.protocols
        _copy_pictures(artifact.root, artifact.metadata.pictures, folder / "pictures")
    else:
        remove(folder / "pictures")
    if digest := outputs.get("usd-export", {}).get("usd-scene"):
        scene = store.open(digest, UsdScene)
        _write(folder / "scene.usdz", scene.path(scene.metadata.package).read_bytes())
    else:
        remove(folder / "scene.usdz")
    if digest := outputs.get("plate-export", {}).get("clean-plates"):
        _copy_plates(store.open(digest, CleanPlates), folder / "plates")
    else:
        remove(folder / "plates")
    effects = read_effects(store, record)
    report = make_report(record, protocols, effects, course)
    _write(folder / "metrics.json", (report.model_dump_json(indent=2) + "\n").encode())
    _write(folder / REPORT, render_report(store, record, folder, course).encode())
    return report


def make_report(
    record: RunRecord,
    protocols: tuple[Any, ...],
    effects: tuple[EffectFigures, ...] = (),
    course: AccuracyCourse | None = None,
) -> RunReport:
    stages = tuple(
        StageFigures(
            node=n.node,
            status=n.status,
            reason=n.reason,
            cached=n.cached,
            wall_s=n.wall_s,
            cpu_s=n.cpu_s,
            peak_memory_bytes=n.peak_memory_bytes,
            key=n.key,
            outputs=n.outputs,
            non_finite=n.non_finite,
        )
        for n in record.nodes
    )
    return RunReport(
        name=record.name,
        run=record.id,
        preset=record.preset,
        status=record.status,
        doubts=record.doubts,
        machine=record.machine,
        stages=stages,
        effects=effects,
        protocols=protocols,
        course=course,
    )


def read_report(folder: Path) -> dict[str, Any]:
    """metrics.json as it stands in a run's folder."""
    return json.loads((folder / "metrics.json").read_text())


def _copy_pictures(root: Path, pictures: tuple[str, ...], target: Path) -> None:
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir()
    for picture in pictures:
        _write(target / Path(picture).name, (root / picture).read_bytes())


def _copy_plates(plates: Artifact[CleanPlates], target: Path) -> None:
    """The data set as other tools read it, whole or not at all."""
    staged = target.with_name(f".{target.name}.new")
    shutil.rmtree(staged, ignore_errors=True)
    record = plates.metadata
    files = [*record.model, record.transforms, *(f for p in record.plates for f in (p.picture, p.mask))]
    for file in files:
        (staged / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(plates.path(file), staged / file)
    shutil.rmtree(target, ignore_errors=True)
    staged.replace(target)


def _write(path: Path, data: bytes) -> None:
    staged = path.with_name(f".{path.name}.new")
    staged.write_bytes(data)
    staged.replace(path)
