"""`inpaint3d runs --serve`: the runs that a store remembers, to be looked at and nothing else."""

import json
from dataclasses import dataclass
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from typing import Any, cast
from urllib.parse import unquote

from inpaint3d.contracts.kit.page_server import Answer, Refusal
from inpaint3d.contracts.models.report import RunRecord
from inpaint3d.contracts.store import Store
from inpaint3d.orchestrator.history import History, name_status
from inpaint3d.orchestrator.pages.dag import draw_dag, format_seconds
from inpaint3d.orchestrator.pages.report import LOG_BYTES, PACKAGE, write_policy
from inpaint3d.orchestrator.progress import PROGRESS
from inpaint3d.report.page import render

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
SHOWN = {".png": "image/png", ".jpg": "image/jpeg", ".json": "text/plain", ".csv": "text/plain", ".txt": "text/plain"}
"""Files of artifacts that a browser shows, by suffix, as what; others are named, with their digests."""


@dataclass(frozen=True)
class RunList:
    """The pages, by path: "", run/NAME/ID, report/NAME, artifact/DIGEST, file/DIGEST/PATH, live.js.

    Whatever a path names is looked up among what there is: no path leads anywhere else.
    """

    store: Store
    runs_dir: Path

    def get(self, path: str) -> Answer:
        """The page at a path; Refusal where there is none."""
        kind, _, rest = unquote(path).partition("/")
        pages = {"": self._list, "run": self._show_run, "report": self._show_report, "artifact": self._show_artifact}
        if kind == "live.js" and not rest:
            return Answer((files(PACKAGE) / "live.js").read_bytes(), "text/javascript")
        if kind == "file":
            return self._show_file(rest)
        if kind not in pages:
            raise Refusal(HTTPStatus.NOT_FOUND, f"there is no page {path}")
        return pages[kind](rest)

    def _list(self, _rest: str) -> Answer:
        history = History(self.store)
        records = [record for name in history.names() for record in history.of(name)]
        records.sort(key=lambda record: record.started, reverse=True)
        return self._answer("runs.html.j2", "", records=records, has_report=self._has_report)

    def _show_run(self, rest: str) -> Answer:
        name, _, identity = rest.partition("/")
        record = self._find(name, identity)
        folder = self.runs_dir / record.name
        live = _read_progress(folder / PROGRESS) if name_status(record) == "running" else {}
        logs = {n.node: _read_end(folder / "logs" / f"{n.node}.log") for n in record.nodes}
        values = {"live": live, "logs": {k: v for k, v in logs.items() if v}, "dag": draw_dag(record.nodes)}
        return self._answer("run.html.j2", "../../", record=record, has_report=self._has_report, **values)

    def _show_report(self, name: str) -> Answer:
        if name not in History(self.store).names() or not (file := self.runs_dir / name / "report.html").is_file():
            raise Refusal(HTTPStatus.NOT_FOUND, f"{name} has no report in {self.runs_dir}")
        policy = write_policy((files(PACKAGE) / "report.js").read_text())
        return Answer(file.read_bytes(), "text/html; charset=utf-8", policy=policy)

    def _show_artifact(self, digest: str) -> Answer:
        if digest not in self.store.objects():
            raise Refusal(HTTPStatus.NOT_FOUND, f"the store has no artifact {digest}")
        manifest = self.store.manifest(digest)
        told = json.dumps(manifest.metadata, indent=2)
        values = {"digest": digest, "manifest": manifest, "told": told, "shown": SHOWN}
        return self._answer("artifact.html.j2", "../", **values)

    def _show_file(self, rest: str) -> Answer:
        digest, _, path = rest.partition("/")
        suffix = Path(path).suffix
        if digest not in self.store.objects() or suffix not in SHOWN:
            raise Refusal(HTTPStatus.NOT_FOUND, f"there is no file {path} to be shown")
        if path not in {file.path for file in self.store.manifest(digest).files}:
            raise Refusal(HTTPStatus.NOT_FOUND, f"the artifact has no file {path}")
        return Answer((self.store.fetch(digest) / path).read_bytes(), SHOWN[suffix], policy=POLICY)

    def _find(self, name: str, identity: str) -> RunRecord:
        history = History(self.store)
        if name in history.names():
            for record in history.of(name):
                if record.id == identity:
                    return record
        raise Refusal(HTTPStatus.NOT_FOUND, f"there is no run {identity} of {name}")

    def _has_report(self, record: RunRecord) -> bool:
        return (self.runs_dir / record.name / "report.html").is_file()

    def _answer(self, template: str, root: str, **values: Any) -> Answer:
        told = {"root": root, "status_of": name_status, "seconds": format_seconds}
        page = render(PACKAGE, template, **told, **values)
        return Answer(page.encode(), "text/html; charset=utf-8", policy=POLICY)


def _read_progress(file: Path) -> dict[str, dict[str, Any]]:
    """Stage -> how far it is; empty where nothing is known."""
    try:
        return cast(dict[str, dict[str, Any]], json.loads(file.read_text()))
    except (OSError, ValueError):
        return {}


def _read_end(log: Path) -> str:
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - LOG_BYTES))
            return file.read().decode("utf-8", "replace").strip()
    except OSError:
        return ""
