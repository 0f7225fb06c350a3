"""Records of runs, as JSON files in the store: `runs/NAME/ID.json`, rewritten whole at every change of state."""

import os
import platform
from collections.abc import Iterator
from pathlib import Path

from pydantic import ValidationError

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import Store


class History:
    """The runs that a store remembers."""

    def __init__(self, store: Store) -> None:
        self._store = store

    def save(self, record: RunRecord) -> None:
        self._store.write(f"runs/{record.name}/{record.id}.json", record.model_dump_json(indent=1).encode())

    def names(self) -> list[str]:
        return self._store.names("runs")

    def of(self, name: str) -> Iterator[RunRecord]:
        """The runs of a name, the newest first."""
        for file in reversed(self._store.names(f"runs/{name}")):
            try:
                yield RunRecord.model_validate_json(self._store.read(f"runs/{name}/{file}") or b"")
            except ValidationError:  # written by another version; not this one's to read
                continue

    def latest(self, name: str) -> RunRecord:
        """The newest run of a name; ConfigurationError where there is none."""
        for record in self.of(name):
            return record
        raise ConfigurationError(f"no run is called {name}; there are {', '.join(self.names()) or 'none yet'}")

    def last_key_of(self, name: str, node: str) -> NodeRun | None:
        """The newest run of a node that had a result, under this name."""
        for record in self.of(name):
            for run in record.nodes:
                if run.node == node and run.status in ("done", "cached"):
                    return run
        return None


def this_machine() -> Machine:
    """What a bare time was measured on."""
    return Machine(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        memory_bytes=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        python=platform.python_version(),
    )


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
