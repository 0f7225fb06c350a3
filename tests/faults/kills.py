"""Runs of no-op stages, killed again and again at random moments, and then left alone.

Each process is forked from one that has imported what it needs: what is killed is the same, and a kill costs half a
second of a core instead of two.
"""

import contextlib
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from benchmarks.overhead import System, write_ours

from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator import cli
from inpaint3d.orchestrator.history import History
from inpaint3d.orchestrator.housekeeping import find_damage
from tests.faults.forks import await_until, fork, is_running, wait_for

WIDTH = 24
MOST_KILLS = 12
"""Of one run, one after another."""
LONGEST_S = (0.3, 1.0, 2.0)
VICTIMS = {"runner": 0, "server": 1, "server of forks": 2, "stage": 3}
"""Who is killed -> how many processes stand between it and the run: stages are forked by a server that was forked."""
NOBODY = "nobody: it had ended, or none was there yet"
Trial = Iterator[tuple[str, str | None]]
"""Whom each kill hit, and what went wrong, if anything did."""


def kill_runs(folder: Path, rng: random.Random) -> Trial:
    """Kill a run, or part of it, several times; then run it to its end.

    After each kill everything visible has to be whole, and a runner that was not hit has to end with a documented code.
    The last run has to succeed, with the results that an undisturbed one has, and no record may say that a run goes on.
    """
    system = write_ours(folder, WIDTH)
    for _ in range(rng.randint(2, MOST_KILLS)):
        whom = rng.choice([*VICTIMS, "group"])
        run = fork(lambda: start_run(system), folder / "stderr.txt")
        found = find_victims(run, whom, rng)
        for pid in found:
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if whom == "group" else os.kill)(pid, signal.SIGKILL)
        code = wait_for(run)
        yield (whom if found else NOBODY), find_fault(folder, whom, code)
        if not found:  # it has ended: the next would find everything done
            break
    code = wait_for(fork(lambda: start_run(system), folder / "stderr.txt"))
    yield "and run to its end", find_fault(folder, "run", code, finished=True)


def start_run(system: System) -> None:
    """Become the runner of a pipeline of no-op stages."""
    os.chdir(system.folder)
    os.environ.clear()
    os.environ.update(system.environment)
    sys.path.insert(0, system.environment["PYTHONPATH"])
    sys.argv = system.command
    cli.main()


def find_victims(run: int, whom: str, rng: random.Random) -> list[int]:
    """The processes to kill, at a random moment; stages, which live for an instant, from the first one on."""
    await_until(lambda: whom != "stage" or bool(find_descendants(run, VICTIMS[whom])), run)
    end = time.monotonic() + rng.uniform(0.0, rng.choice(LONGEST_S))
    await_until(lambda: time.monotonic() > end, run)
    if whom == "group":
        return [run] if is_running(run) else []
    await_until(lambda: bool(find_descendants(run, VICTIMS[whom])), run)
    return find_descendants(run, VICTIMS[whom]) if is_running(run) else []


def find_fault(folder: Path, whom: str, code: int, *, finished: bool = False) -> str | None:
    """What is wrong with a store after a kill, or after a run that nobody disturbed; None for nothing."""
    said = (folder / "stderr.txt").read_text()[-300:]
    if code == 1 or (finished and code != 0):
        return f"exit {code} after a kill of the {whom}: {said}"
    store = FolderStore(folder / "store")
    if damage := list(find_damage(store)):
        return f"partly there after a kill of the {whom}: {damage[0].what}"
    if not finished:
        return None
    if "running" in {r.status for r in History(store).of("capture")}:
        return "a record stayed running"
    numbers = sorted(read_number(store, node.outputs["made"]) for node in History(store).latest("capture").nodes)
    return None if numbers == list(range(WIDTH + 2)) else f"wrong results: {numbers}"


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
    found: list[int] = []
    for thread in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):  # it has ended
            found += map(int, thread.read_text().split())
    return found
