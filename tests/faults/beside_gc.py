"""Many processes that commit results to one store, while another one collects garbage in it without a pause.

    python -m tests.faults.beside_gc [--processes 8] [--results 100]

Each process does what a run does: under the store's shared lock it commits results, records the run that needs them,
and looks each of them up again. None may be gone, or be another one.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from inpaint3d.contracts.errors import RetryableError
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.report import Machine, NodeRun, RunRecord
from inpaint3d.contracts.store import FolderStore, Record
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import collect, find_damage
from tests.faults.results import conclude

MACHINE = Machine(processor="p", cores=1, memory_bytes=1, python="3")


def commit_runs(place: Path, name: str, results: int) -> int:
    """Commit and record one result after another; how many were not there when looked for, or were wrong."""
    store, wrong = FolderStore(place), 0
    for i in range(results):
        with store.shared():
            components = {"run": name, "seed": i}
            key = digest_of(components)
            with store.lock(key):
                folder = store.private_folder()
                (folder / "a.txt").write_text(f"{name} {i}")
                digest = store.put(folder, "source", Source(name=name, kind="folder"))
                store.commit(
                    Record(
                        key=key, stage="s@1", components=components, outputs={"x": digest}, provenance={}, timings={}
                    )
                )
            node = NodeRun(node="n", status="done", reason="", key=key, components=components, outputs={"x": digest})
            History(store).save(
                RunRecord(
                    id=History(store).new_id(name), name=name, pipeline="p", preset=None, externals={}, status="done",
                    started="now", machine=MACHINE, nodes=(node,),
                )
            )  # fmt: skip
        found = store.lookup(key)  # of the last run of a name gc takes nothing
        wrong += found is None or (store.fetch(found.outputs["x"]) / "a.txt").read_text() != f"{name} {i}"
    return wrong


def carry_out(place: Path, processes: int, results: int) -> tuple[dict[str, int], list[str]]:
    """How many results were committed and how often gc ran or found the store in use; what went wrong."""
    program = "import sys; from pathlib import Path; from tests.faults.beside_gc import commit_runs; "
    program += "sys.exit(commit_runs(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])))"
    line = [sys.executable, "-c", program, str(place)]
    running = [subprocess.Popen([*line, f"run-{i}", str(results)]) for i in range(processes)]
    store, counts = FolderStore(place), {"results": processes * results, "gc ran": 0, "gc refused": 0}
    while any(process.poll() is None for process in running):
        try:
            collect(store, keep=1, dry_run=False)
            counts["gc ran"] += 1
        except RetryableError:
            counts["gc refused"] += 1
            time.sleep(0.001)
    faults = [f"process {i}: exit {p.returncode}" for i, p in enumerate(running) if p.returncode]
    faults += [damage.what for damage in find_damage(store)]
    kept = {record.key for record in store.records()}
    whole = sum(History(store).latest(f"run-{i}").nodes[0].key in kept for i in range(processes))
    if whole != processes:
        faults.append(f"of {processes} last runs {processes - whole} lost their result")
    return counts, faults


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--processes", type=int, default=8)
    parser.add_argument("--results", type=int, default=100)
    parser.add_argument("--out", type=Path, help="a JSON file with a section of each of these programs")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        counts, faults = carry_out(Path(folder), given.processes, given.results)
    conclude("beside gc", counts, faults, given.out)


if __name__ == "__main__":
    main()
