"""Records of runs, as JSON files in the store: `runs/NAME/ID.json`, rewritten whole at every change of state."""

import datetime
import os
import platform
import secrets
from collections.abc import Collection, Iterator
from pathlib import Path

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import Store, note, parse_owner


class History:
    """The runs that a store remembers, in the order of their sequence numbers: clocks jump, and machines differ."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._told: set[str] = set()

    def new_id(self, name: str) -> str:
        """An id for the next run of a name; it comes after all that there are, whatever the clock says."""
        last = max(map(_parse_sequence, self._store.names(f"runs/{name}")), default=0)
        return f"{last + 1:06d}-{datetime.datetime.now(datetime.UTC):%Y%m%dT%H%M%S}-{secrets.token_hex(2)}"

    def save(self, record: RunRecord) -> None:
        """Write a run's record anew; a store that is to be read only remembers nothing, which is said once."""
        if not self._store.is_writable:
            self._tell(f"{self._store.place} is read-only: it will not remember this run")
            return
        self._store.write(f"runs/{record.name}/{record.id}.json", record.encode())

    def names(self) -> list[str]:
        return self._store.names("runs")

    def documents(self, name: str) -> Iterator[tuple[str, bytes]]:
        """Path and bytes of every record of a name, the newest first, whoever wrote it."""
        for file in sorted(self._store.names(f"runs/{name}"), key=lambda f: (_parse_sequence(f), f), reverse=True):
            path = f"runs/{name}/{file}"
            yield path, self._store.read(path) or b""
        if stray := self._store.read(f"runs/{name}"):  # a file where the folder should be
            yield f"runs/{name}", stray

    def of(self, name: str) -> Iterator[RunRecord]:
        """The runs of a name, the newest first. What cannot be read here is passed over, and said once."""
        for path, data in self.documents(name):
            try:
                yield RunRecord.decode(data)
            except ValueError:
                self._tell(f"{self._store.place}/{path} is damaged or of another version; passed over")

    def latest(self, name: str) -> RunRecord:
        """The newest run of a name; ConfigurationError where there is none."""
        for record in self.of(name):
            return record
        raise ConfigurationError(f"no run is called {name}; there are {', '.join(self.names()) or 'none yet'}")

    def last_results(self, name: str, nodes: Collection[str]) -> dict[str, NodeRun]:
        """Of each of these nodes the newest run under this name that had a result."""
        found: dict[str, NodeRun] = {}
        for record in self.of(name):
            for run in record.nodes:
                if run.node in nodes and run.status in ("done", "cached"):
                    found.setdefault(run.node, run)
            if len(found) == len(nodes):
                break
        return found

    def close_killed(self, name: str) -> None:
        """End the records of runs that were killed before they could do so themselves."""
        for record in self.of(name):
            if is_killed(record):
                self.save(record.model_copy(update={"status": "stopped", "error": "its process was killed"}))

    def _tell(self, message: str) -> None:
        if message not in self._told:
            self._told.add(message)
            note(message)


def name_status(record: RunRecord) -> str:
    """A run's status as a person is told: one whose process is gone does not run, whatever its record says."""
    return "killed" if is_killed(record) else record.status


def is_killed(record: RunRecord) -> bool:
    """Whether a run that is recorded as running has no process any more."""
    owner = parse_owner(record.process or "")
    return record.status == "running" and owner is not None and owner.is_gone


def _parse_sequence(file: str) -> int:
    """The number that a record's file begins with; 0 for what has none."""
    number, dash, _ = file.partition("-")
    return int(number) if dash and number.isdecimal() else 0


def this_machine() -> Machine:
    """What a bare time was measured on."""
    return Machine(
        processor=_name_processor(),
        cores=len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1,
        memory_bytes=os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        python=platform.python_version(),
    )


def _name_processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
