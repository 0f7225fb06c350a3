"""What a run leaves where a person looks: report.html, scene.usdz, metrics.json, pictures/, plates/ in `runs/NAME/`."""

import json
import shutil
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import ArtifactError
from inpaint3d.contracts.models.artifacts import CleanPlates, Evaluation, UsdScene
from inpaint3d.contracts.models.report import EffectFigures, RunRecord, RunReport, StageFigures
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.orchestrator.effects import read_effects
from inpaint3d.orchestrator.times import render_times
from inpaint3d.report.page import DOUBT_MARKER, RUN_MARKER, render


def publish(store: Store, record: RunRecord, folder: Path) -> RunReport:
    """Write the results of a run, replacing what an earlier run of the name left. Returns what metrics.json says."""
    folder.mkdir(parents=True, exist_ok=True)
    outputs = {n.node: n.outputs for n in record.nodes}
    protocols: tuple[Any, ...] = ()
    if digest := outputs.get("evaluation", {}).get("evaluation"):
        artifact = store.open(digest, Evaluation)
        protocols = artifact.metadata.protocols
        _copy_pictures(artifact.root, artifact.metadata.pictures, folder / "pictures")
        html = artifact.path(artifact.metadata.report).read_text()
        for marker, section in _render_sections(store, record).items():
            if marker not in html:
                raise ArtifactError(
                    f"{artifact.metadata.report} of {digest} lacks the line {marker}; re-run evaluation"
                )
            html = html.replace(marker, section)
        _write(folder / "report.html", html.encode())
    if digest := outputs.get("usd-export", {}).get("usd-scene"):
        scene = store.open(digest, UsdScene)
        _write(folder / "scene.usdz", scene.path(scene.metadata.package).read_bytes())
    if digest := outputs.get("plate-export", {}).get("clean-plates"):
        _copy_plates(store.open(digest, CleanPlates), folder / "plates")
    report = make_report(record, protocols, read_effects(store, record))
    _write(folder / "metrics.json", (report.model_dump_json(indent=2) + "\n").encode())
    return report


def _render_sections(store: Store, record: RunRecord) -> dict[str, str]:
    """What a run adds to the page of its evaluation, by the line that it takes the place of."""
    doubts = render("inpaint3d.orchestrator", "doubts.html.j2", doubts=record.doubts) if record.doubts else ""
    return {DOUBT_MARKER: doubts, RUN_MARKER: render_times(store, record)}


def make_report(record: RunRecord, protocols: tuple[Any, ...], effects: tuple[EffectFigures, ...] = ()) -> RunReport:
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
