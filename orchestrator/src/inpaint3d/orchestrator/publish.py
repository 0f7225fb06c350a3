"""Leave in `runs/NAME/` what a person looks at: the report, metrics.json, and the results that `results.py` names."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from inpaint3d.contracts.models.report import AccuracyCourse, EffectFigures, RunRecord, RunReport, StageFigures
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.contracts.store.workspace import remove
from inpaint3d.orchestrator.accuracy import follow_accuracy
from inpaint3d.orchestrator.effects import read_effects
from inpaint3d.orchestrator.pages.report import render_report
from inpaint3d.orchestrator.results import EVALUATION, METRICS, RESULTS

REPORT = "report.html"


def publish(store: Store, record: RunRecord, folder: Path) -> RunReport:
    """Write the results of a run, replacing what an earlier run of the name left. Returns what metrics.json says.

    What the run has no result for goes: nothing of an earlier run lies beside the report of this one.
    """
    folder.mkdir(parents=True, exist_ok=True)
    course = follow_accuracy(store, record)
    for result in RESULTS:
        artifact = result.open(store, record)
        if artifact is None:
            remove(folder / result.place)
        else:
            _copy(artifact, result.list_files(artifact.metadata), folder / result.place)
    scores = EVALUATION.open(store, record)
    protocols = () if scores is None else scores.metadata.protocols
    report = make_report(record, protocols, read_effects(store, record), course)
    _write(folder / METRICS, (report.model_dump_json(indent=2) + "\n").encode())
    _write(folder / REPORT, render_report(store, record, folder, course).encode())
    return report


def make_report(
    record: RunRecord,
    protocols: tuple[Any, ...],
    effects: tuple[EffectFigures, ...] = (),
    course: AccuracyCourse | None = None,
) -> RunReport:
    """What metrics.json says of a run."""
    figures = StageFigures.model_fields
    return RunReport(
        name=record.name,
        run=record.id,
        preset=record.preset,
        status=record.status,
        doubts=record.doubts,
        machine=record.machine,
        stages=tuple(StageFigures.model_validate({name: getattr(n, name) for name in figures}) for n in record.nodes),
        effects=effects,
        protocols=protocols,
        course=course,
    )


def read_report(folder: Path) -> dict[str, Any]:
    """metrics.json as it stands in a run's folder."""
    return json.loads((folder / METRICS).read_text())


def _copy(artifact: Artifact[Any], files: Mapping[str, str], target: Path) -> None:
    """Files of an artifact as one file or folder, whole or not at all; `files`: path below the target -> artifact's."""
    staged = target.with_name(f".{target.name}.new")
    remove(staged)
    if "" not in files:
        staged.mkdir()
    for inside, file in files.items():
        (staged / inside).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(artifact.path(file), staged / inside)
    if target.is_dir() or staged.is_dir():  # a file is put over a file in one step
        remove(target)
    staged.replace(target)


def _write(path: Path, data: bytes) -> None:
    staged = path.with_name(f".{path.name}.new")
    staged.write_bytes(data)
    staged.replace(path)
