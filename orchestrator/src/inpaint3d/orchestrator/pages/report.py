"""`report.html`: one file that says what a run came to, needs nothing beside it, and fetches nothing."""

import base64
import hashlib
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import TypeVar

from inpaint3d.contracts.models.artifacts import (
    CleanPlates,
    Evaluation,
    MaskSet,
    PictureStrip,
    PosedCapture,
    RadianceFieldArtifact,
    SplatScene,
    UsdScene,
)
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.report import AccuracyCourse, NodeRun, RunRecord
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.orchestrator.accuracy import render_course
from inpaint3d.orchestrator.effects import read_effects
from inpaint3d.orchestrator.pages.dag import draw_dag, format_seconds
from inpaint3d.orchestrator.pages.effects import EffectRow, describe_effects
from inpaint3d.orchestrator.pages.exports import Export, describe_plates, describe_scene, describe_splats
from inpaint3d.orchestrator.pages.orbit import Orbit, build_orbit
from inpaint3d.orchestrator.pages.pictures import Strip, cut_strip, fit_into
from inpaint3d.orchestrator.pages.tables import list_views, make_table
from inpaint3d.orchestrator.pages.verdict import KNOWN, TRUTH, find_metrics, judge
from inpaint3d.orchestrator.results import LOGS, METRICS, RESULTS
from inpaint3d.orchestrator.times import render_times
from inpaint3d.report.page import render

M = TypeVar("M", bound=Closed)
PACKAGE = "inpaint3d.orchestrator.pages"
STRIPS_BYTES = 3 * 2**20
"""Of the views side by side, as files: with the orbit and base64's third the page stays under 10 MB."""
LOG_BYTES = 4000


@dataclass(frozen=True)
class Page:
    """All that the page of a run shows, read from its record and the store."""

    store: Store
    record: RunRecord
    folder: Path

    @cached_property
    def evaluation(self) -> Artifact[Evaluation] | None:
        return self._open("evaluation", "evaluation", Evaluation)

    @cached_property
    def masks(self) -> MaskSet | None:
        found = self._open("mask-authoring", "mask-set", MaskSet)
        return found.metadata if found else None

    @cached_property
    def capture(self) -> PosedCapture | None:
        found = self._open("pose-estimation", "posed-capture", PosedCapture)
        return found.metadata if found else None

    @property
    def exports(self) -> list[Export]:
        """What people take on from here."""
        scene = self._open("usd-export", "usd-scene", UsdScene)
        plates = self._open("plate-export", "clean-plates", CleanPlates)
        splats = self._open("splat-export", "splat-scene", SplatScene)
        found = [describe_scene(scene.metadata)] if scene else []
        found += [describe_plates(plates.metadata)] if plates else []
        return [*found, describe_splats(splats.metadata)] if splats else found

    @property
    def effects(self) -> Sequence[EffectRow]:
        return describe_effects(read_effects(self.store, self.record))

    @property
    def contact(self) -> Strip | None:
        return self._cut("contact", self.evaluation.metadata.contact) if self.evaluation else None

    @property
    def strips(self) -> list[Strip]:
        """Of the other views as many as fit."""
        if self.evaluation is None:
            return []
        by_file = {self.evaluation.path(strip.file): strip for strip in self.evaluation.metadata.strips}
        found = [self._cut(f"strip-{i}", by_file[file]) for i, file in enumerate(fit_into(by_file, STRIPS_BYTES))]
        return [strip for strip in found if strip is not None]

    @property
    def orbit(self) -> Orbit | None:
        before, after = (self._find(n, "radiance-field") for n in ("nerf-pretraining", "joint-optimization"))
        return build_orbit(self.store, before, after)

    @property
    def health(self) -> dict[str, dict[str, float]]:
        """Node -> counters of its fit."""
        found: dict[str, dict[str, float]] = {}
        for n in self.record.nodes:
            if "radiance-field" in n.outputs:
                counters = self.store.open(n.outputs["radiance-field"], RadianceFieldArtifact).metadata.health
                found |= {n.node: counters} if counters else {}
        return found

    @property
    def non_finite(self) -> dict[str, int]:
        return {f"{n.node}: {place}": c for n in self.record.nodes for place, c in n.non_finite.items() if c}

    @property
    def figures(self) -> list[tuple[str, str, str]]:
        """(what, value, of what) of the few numbers that a glance is for."""
        found: list[tuple[str, str, str]] = []
        if self.evaluation:
            hole = {m.name: m for m in find_metrics(self.evaluation.metadata, TRUTH)}
            known = {m.name: m for m in find_metrics(self.evaluation.metadata, KNOWN)}
            found += [("Hole, PSNR", f"{m.value:.1f} dB", "against the truth") for k, m in hole.items() if k == "psnr"]
            found += [("Hole, LPIPS", f"{m.value:.3f}", "0 is identical") for k, m in hole.items() if k == "lpips_vgg"]
            found += [("Kept, PSNR", f"{m.value:.1f} dB", "unseen photos") for k, m in known.items() if k == "psnr"]
        if self.masks and self.masks.consistency is not None:
            found.append(("Masks agree", f"{self.masks.consistency:.0%}", "IoU of neighbouring views"))
        if self.record.wall_s is not None:
            ran = sum(n.status == "done" for n in self.record.nodes)
            cached = sum(n.cached for n in self.record.nodes)
            found.append(("Time", format_seconds(self.record.wall_s), f"{ran} stages ran, {cached} cached"))
        return found

    @property
    def culprits(self) -> list[tuple[NodeRun, str]]:
        """Stages that failed, with the end of their logs."""
        return [(n, self._read_log(n.node)) for n in self.record.nodes if n.status in ("failed", "waiting", "stopped")]

    @property
    def command(self) -> str:
        return shlex.join(self.record.command) if self.record.command else f"inpaint3d publish {self.record.name}"

    @property
    def results(self) -> list[str]:
        """What lies beside the page."""
        names = [METRICS, *(result.place for result in RESULTS), LOGS]
        return [name for name in names if (self.folder / name).exists() or name == METRICS]

    @property
    def logs(self) -> list[str]:
        return [n.node for n in self.record.nodes if (self.folder / LOGS / f"{n.node}.log").is_file()]

    def _read_log(self, node: str) -> str:
        try:
            data = (self.folder / LOGS / f"{node}.log").read_bytes()
        except OSError:
            return ""
        return data[-LOG_BYTES:].decode("utf-8", "replace").strip()

    def _cut(self, name: str, strip: PictureStrip | None) -> Strip | None:
        return cut_strip(name, self.evaluation.path(strip.file), strip) if strip and self.evaluation else None

    def _find(self, node: str, port: str) -> Digest | None:
        return next((n.outputs.get(port) for n in self.record.nodes if n.node == node), None)

    def _open(self, node: str, port: str, model: type[M]) -> Artifact[M] | None:
        digest = self._find(node, port)
        return None if digest is None else self.store.open(digest, model)


def render_report(store: Store, record: RunRecord, folder: Path, course: AccuracyCourse | None = None) -> str:
    """The page of a run, however it ended; `folder` is where it will lie, with its logs. course: what accuracy cost.

    Raises ArtifactError where a result that the record names cannot be read any more.
    """
    script = (files(PACKAGE) / "report.js").read_text()
    page = Page(store, record, folder)
    evaluation = page.evaluation
    protocols = evaluation.metadata.protocols if evaluation else ()
    return render(
        PACKAGE,
        "report.html.j2",
        page=page,
        record=record,
        verdict=judge(record, evaluation.metadata if evaluation else None),
        tables=[make_table(p) for p in protocols],
        view_tables=list_views(evaluation.path(evaluation.metadata.per_view), protocols) if evaluation else [],
        dag=draw_dag(record.nodes),
        accuracy=render_course(course) + render_times(store, record),
        seconds=format_seconds,
        script=script,
        policy=write_policy(script),
    )


def write_policy(script: str) -> str:
    """The Content-Security-Policy of a page that stands alone: this inline script, and nothing from elsewhere."""
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'"
