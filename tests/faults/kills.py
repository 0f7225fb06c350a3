"""A run of no-op stages, killed at a random moment, and run again."""

import contextlib
import os
import random
import signal
import subprocess
import time
from pathlib import Path

from benchmarks.overhead import write_ours

from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import find_damage

WIDTH = 3
LONGEST_S = 3.0
VICTIMS = {"runner": 0, "server": 1, "server of forks": 2, "stage": 3}
"""Who is killed -> how many processes stand between it and the run: stages are forked by a server that was forked."""


def try_kill(folder: Path, rng: random.Random) -> tuple[str, str | None]:
    """Kill a run, or part of it, and run again: whom, and what went wrong, if anything did.

    The second run has to succeed, with the results that an undisturbed one has; everything visible has to be whole, and
    no record may say that a run is still going on.
    """
    system = write_ours(folder, WIDTH)
    whom = rng.choice([*VICTIMS, "group"])
    process = subprocess.Popen(
        system.command, cwd=folder, env=system.environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    time.sleep(rng.uniform(0.2, LONGEST_S))
    victims = [process.pid] if whom == "group" else find_descendants(process.pid, VICTIMS[whom])
    if process.poll() is not None or not victims:
        whom = "nobody: it had ended, or none was there yet"
    else:
        for pid in victims:
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if whom == "group" else os.kill)(pid, signal.SIGKILL)
    process.wait()
    again = subprocess.run(
        system.command, cwd=folder, env=system.environment, capture_output=True, text=True, check=False
    )
    if again.returncode != 0:
        return whom, f"exit {again.returncode} after a kill of the {whom}: {again.stderr[-300:]}"
    store = FolderStore(folder / "store")
    if damage := list(find_damage(store)):
        return whom, f"partly there after a kill of the {whom}: {damage[0].what}"
    if "running" in {r.status for r in History(store).of("capture")}:
        return whom, f"a record stayed running after a kill of the {whom}"
    numbers = sorted(read_number(store, node.outputs["made"]) for node in History(store).latest("capture").nodes)
    return whom, None if numbers == list(range(WIDTH + 2)) else f"wrong results after a kill of the {whom}: {numbers}"


def read_number(store: FolderStore, digest: str) -> int:
    """What a no-op stage has written."""
    return int((store.fetch(digest) / "number.txt").read_text())


def find_descendants(pid: int, generations: int) -> list[int]:
    """The processes that one has started, those have started, ..."""
    found = [pid]
    for _ in range(generations):
        found = [child for parent in found for child in _children(parent)]
    return found


def _children(pid: int) -> list[int]:
    with contextlib.suppress(OSError):
        return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return []
