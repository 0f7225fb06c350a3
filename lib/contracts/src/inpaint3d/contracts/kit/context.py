"""What a stage is given to work with: its inputs, its outputs, and the context of the run."""

import json
import math
import os
import resource
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar, cast

from inpaint3d.contracts.errors import ArtifactError, ConfigurationError, InterruptedRun
from inpaint3d.contracts.models.base import Closed, Digest
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.models.manifest import is_compatible
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.contracts.store import Artifact, Store
from inpaint3d.contracts.store.workspace import remove

M = TypeVar("M", bound=Closed)
T = TypeVar("T")

PROGRESS_INTERVAL_S = 0.2
CLOCK_INTERVAL_S = 2.0


class Inputs:
    """A stage's input artifacts by port, verified against their digests before they are read."""

    def __init__(self, store: Store, spec: StageSpec, digests: Mapping[str, Digest | list[Digest]]) -> None:
        self._store, self._spec, self._digests = store, spec, digests
        self.opened: dict[str, Path] = {}
        """Port -> where the artifacts that were read lie, for telling whose data an error is about."""

    def one(self, port: str, model: type[M]) -> Artifact[M]:
        """The artifact at a port; ArtifactError where it is missing or of another schema."""
        artifact = self.optional(port, model)
        if artifact is None:
            raise ArtifactError(f"{self._spec.id}: no artifact at its input {port}; run the stage that writes it")
        return artifact

    def optional(self, port: str, model: type[M]) -> Artifact[M] | None:
        """The artifact at an optional port, or None."""
        digest = self._digests.get(port)
        if digest is None or isinstance(digest, list):
            return None
        return self._open(port, digest, model)

    def many(self, port: str, model: type[M]) -> list[Artifact[M]]:
        """The artifacts at a list port, in the order they are wired."""
        digests = self._digests.get(port, [])
        return [self._open(port, d, model) for d in ([digests] if isinstance(digests, str) else digests)]

    def _open(self, port: str, digest: Digest, model: type[M]) -> Artifact[M]:
        wanted = self._spec.spec.inputs[port].schema_range
        written = self._store.manifest(digest).schema_id
        if not is_compatible(written, wanted):
            raise ArtifactError(f"{self._spec.id}: its input {port} takes {wanted}, got {written} ({digest})")
        artifact = self._store.open(digest, model)
        self.opened[port] = artifact.root
        return artifact


class Outputs:
    """A stage's outputs: a private folder for each port, made an artifact by `write`, visible only when all is done."""

    def __init__(self, store: Store, spec: StageSpec) -> None:
        self._store, self._spec = store, spec
        self._folders: dict[str, Path] = {}
        self._written: dict[str, Closed] = {}

    def folder(self, port: str) -> Path:
        """The private folder of a port; subfolders are the stage's to make."""
        if port not in self._spec.spec.outputs:
            raise ArtifactError(f"{self._spec.id} declares no output {port}")
        if port not in self._folders:
            self._folders[port] = self._store.private_folder()
        return self._folders[port]

    def write(self, port: str, metadata: Closed) -> None:
        """Declare a port's folder complete, with its metadata."""
        self.folder(port)
        self._written[port] = metadata

    def store_all(self) -> dict[str, Digest]:
        """Move all that was written into the store; ArtifactError where a required port was not."""
        declared = self._spec.spec.outputs
        missing = [p for p, d in declared.items() if not d.optional and p not in self._written]
        unfinished = [p for p in self._folders if p not in self._written]
        if missing or unfinished:
            raise ArtifactError(f"{self._spec.id} did not write its outputs {', '.join({*missing, *unfinished})}")
        return {
            port: self._store.put(self._folders[port], declared[port].schema_id.partition("@")[0], metadata)
            for port, metadata in self._written.items()
        }

    def discard(self) -> None:
        """Give back the space of what was begun and will not be stored."""
        for folder in self._folders.values():
            remove(folder)


class Emit(Protocol):
    """Tells whoever started the stage what happens: one event, a flat mapping."""

    def __call__(self, event: str, **values: Any) -> None: ...


class Context:
    """Seed, device, threads, checkpoints, progress, clocks and counters of one run."""

    def __init__(self, *, seed: int, device: str, threads: int, work: Path, emit: Emit) -> None:
        self.seed, self.device, self.threads, self.work = seed, device, threads, work
        self.non_finite: dict[str, int] = {}
        self.doubts: list[str] = []
        self.health: dict[str, float] = {}
        """Counters of a fit by name; the sidecar has them beside the times."""
        self.stopping = False
        self._emit = emit
        self._last_progress = self._last_clock = 0.0
        self._start = (time.monotonic(), _measure_cpu_s())
        self._before = self._load_clock()

    def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
        """Tell how far the work is, at most five times a second. Raises InterruptedRun once SIGTERM has come."""
        if self.stopping:
            raise InterruptedRun("stopped; checkpoints are kept, the next run goes on from them")
        now = time.monotonic()
        if now - self._last_progress >= PROGRESS_INTERVAL_S or done >= total:
            self._last_progress = now
            self._emit("progress", done=done, total=total, message=message, **self._keep_finite("progress", figures))
        if now - self._last_clock >= CLOCK_INTERVAL_S:
            self._save_clock(now)

    def log(self, message: str, **values: Any) -> None:
        """Tell something that a person may want to know."""
        self._emit("log", message=message, **values)

    def doubt(self, message: str) -> None:
        """Say why the result cannot be right, with figures and the repair; the run stops unless somebody insists."""
        self.doubts.append(message)
        self.log(f"doubtful: {message}")

    def record(self, series: str, **row: float | str) -> None:
        """Append a row with the wall and CPU seconds so far to a series of the sidecar.

        A figure that is not finite, which JSON has no word for, is left out and counted.
        """
        wall, cpu = self.elapsed()
        line = {
            "series": series,
            **self._keep_finite(f"series.{series}", row),
            "wall_s": round(wall, 3),
            "cpu_s": round(cpu, 3),
        }
        path = self.work / "series.jsonl"
        if path.is_dir():
            remove(path)
        with path.open("ab") as file:
            file.write(canonical_json(line) + b"\n")

    def _keep_finite(self, place: str, figures: Mapping[str, T]) -> dict[str, T]:
        lost = [name for name, value in figures.items() if isinstance(value, float) and not math.isfinite(value)]
        for name in lost:
            where = f"{place}.{name}"
            self.non_finite[where] = self.non_finite.get(where, 0) + 1
        return {name: value for name, value in figures.items() if name not in lost}

    def elapsed(self) -> tuple[float, float]:
        """Wall and CPU seconds of the work so far, those before a kill included."""
        wall, cpu = self._start
        return self._before[0] + time.monotonic() - wall, self._before[1] + _measure_cpu_s() - cpu

    def timings(self) -> dict[str, Any]:
        """What the sidecar says of the run."""
        wall, cpu = self.elapsed()
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return {
            "wall_s": round(wall, 3),
            "cpu_s": round(cpu, 3),
            "peak_memory_bytes": peak * 1024,
            "threads": self.threads,
            "non_finite": self.non_finite,
            "doubts": self.doubts,
            "health": self.health,
            "series": self._read_series(),
        }

    def _read_series(self) -> dict[str, list[dict[str, Any]]]:
        """The recorded rows. After a kill some steps were done twice: the later row counts."""
        path = self.work / "series.jsonl"
        series: dict[str, dict[Any, dict[str, Any]]] = {}
        for i, line in enumerate(path.read_bytes().splitlines() if path.is_file() else []):
            if (row := _read_row(line)) is not None:
                series.setdefault(row.pop("series"), {})[row.get("step", i)] = row
        return {name: list(rows.values()) for name, rows in series.items()}

    def _load_clock(self) -> tuple[float, float]:
        try:
            wall, cpu = (float(seconds) for seconds in json.loads((self.work / "clock.json").read_text()))
        except (OSError, ValueError, TypeError, RecursionError):
            return (0.0, 0.0)
        return (wall, cpu) if 0 <= wall < math.inf and 0 <= cpu < math.inf else (0.0, 0.0)

    def _save_clock(self, now: float) -> None:
        self._last_clock = now
        staged = self.work / "clock.json.new"
        staged.write_text(json.dumps(self.elapsed()))
        clock = self.work / "clock.json"
        if clock.is_dir():
            remove(clock)
        staged.replace(clock)


def _read_row(line: bytes) -> dict[str, Any] | None:
    """A row of a series; None for a line that a kill cut short, or that is none of ours."""
    try:
        row = json.loads(line)
        canonical_json(row)
    except (ValueError, ConfigurationError, RecursionError):
        return None
    if not isinstance(row, dict):
        return None
    named = cast(dict[str, Any], row)
    hashable = isinstance(named.get("step", 0), int | float | str)
    return named if isinstance(named.get("series"), str) and hashable else None


def _measure_cpu_s() -> float:
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system
