"""Every place where a run writes, one after another, told that the disk is full, or fails, or is read-only, or killed.

    python -m tests.faults.write_sites [--errors ENOSPC EIO EROFS EMFILE KILL] [--first 1] [--last 1000]

The n-th writing call of a process (a file opened for writing, a folder made, something renamed, linked or removed) in
the store or the run's folder raises the error, or is where the process is killed, for n = 1, 2, ... until a run has no
n-th one. Each has to end with the code of that error, or well where what could not be written is needed by nobody; the
same command without it has to succeed, and everything that can be seen has to be whole.
"""

import argparse
import errno
import itertools
import os
import runpy
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.overhead import write_ours

import inpaint3d
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.models.artifacts import Source
from inpaint3d.contracts.store import FolderStore
from inpaint3d.orchestrator.housekeeping import find_damage
from tests.faults.forks import fork, wait_for
from tests.faults.kills import start_run
from tests.faults.results import conclude

WIDTH = 1
KILL = "KILL"
CODES = {"ENOSPC": 5, "EIO": 5, "EROFS": 5, "EMFILE": 75, KILL: -signal.SIGKILL}
FIRED = "a fault was told of"
WRITING = ("os.mkdir", "os.rename", "os.link", "os.remove", "os.rmdir", "os.symlink", "os.chmod")
Become = Callable[[], None]
"""What a forked process does."""


def fail_at(at: int, error: str) -> None:
    """Have this process's n-th writing call in a store or a run's folder raise an OSError, or kill it.

    What the process starts is spared.
    """
    seen = 0

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal seen
        if event == "open":
            writes = isinstance(arguments[2], int) and bool(arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))
        else:
            writes = event in WRITING
        if writes and any(part in str(arguments[0]) for part in ("/store/", "/runs/")):
            seen += 1
            if seen == at:
                os.write(2, f"{FIRED}\n".encode())
                if error == KILL:
                    os.kill(os.getpid(), signal.SIGKILL)
                number = getattr(errno, error)
                raise OSError(number, os.strerror(number), str(arguments[0]))

    sys.addaudithook(hook)


def write_run(folder: Path) -> Become:
    """A run of a few no-op stages: the orchestrator's own writes."""
    system = write_ours(folder, WIDTH)
    places = ["--store", str(folder / "store"), "--runs-dir", str(folder / "runs")]
    return lambda: start_run(replace(system, command=[*system.command, *places]))


def write_stage(folder: Path) -> Become:
    """A no-op stage by itself: the writes of a stage."""
    system = write_ours(folder, WIDTH)
    store = FolderStore(folder / "store")
    private = store.private_folder()
    (private / "raw").mkdir()
    (private / "raw" / "a.txt").write_text("nothing")
    digest = store.put(private, "source", Source(name="a", kind="folder"))
    invocation = Invocation(parameters={"number": 0}, inputs={"source": [digest]})
    (folder / "invocation.json").write_text(invocation.model_dump_json())

    def become() -> None:
        # Where our packages lie was looked up before this one was written.
        inpaint3d.__path__.append(str(Path(system.environment["PYTHONPATH"], "inpaint3d")))
        sys.path.insert(0, system.environment["PYTHONPATH"])
        sys.argv = ["run", "run", "--store", str(store.root), "--invocation", str(folder / "invocation.json")]
        runpy.run_module("inpaint3d.stages.noop", run_name="__main__", alter_sys=True)

    return become


KINDS: dict[str, Callable[[Path], Become]] = {"run": write_run, "stage": write_stage}


def try_site(kind: str, error: str, at: int, folder: Path) -> tuple[bool, list[str]]:
    """Whether there is an n-th write, and what went wrong when it failed."""
    become, said = KINDS[kind](folder), folder / "stderr.txt"

    def harmed() -> None:
        fail_at(at, error)
        become()

    code = wait_for(fork(harmed, said))
    if FIRED not in said.read_text():
        return False, []
    faults: list[str] = []
    if code not in (0, CODES[error]):
        faults.append(f"exit {code}: {said.read_text()[-600:]}")
    if code := wait_for(fork(become, said)):
        faults.append(f"and then, exit {code}: {said.read_text()[-600:]}")
    faults += [damage.what for damage in find_damage(FolderStore(folder / "store"))]
    return True, [f"{kind}, {error} at write {at}: {fault}" for fault in faults]


def try_all(kind: str, error: str, folder: Path, first: int = 1, last: int = 1000) -> tuple[int, list[str]]:
    """Sites that were tried, and what went wrong."""
    faults: list[str] = []
    for at in itertools.count(first):
        place = folder / "site"
        place.mkdir()
        there, found = try_site(kind, error, at, place)
        shutil.rmtree(place)
        faults += found
        if not there or at == last:
            return at - first + there, faults
    raise AssertionError("count() does not end")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--errors", nargs="+", default=list(CODES), choices=list(CODES))
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--last", type=int, default=1000)
    parser.add_argument("--out", type=Path, help="a JSON file with a section of each of these programs")
    given = parser.parse_args()
    counts: dict[str, int] = {}
    faults: list[str] = []
    for kind in KINDS:
        for error in given.errors:
            with tempfile.TemporaryDirectory() as folder:
                counts[f"{kind} {error}"], found = try_all(kind, error, Path(folder), given.first, given.last)
            faults += found
    conclude("write sites", {"writes": counts}, faults, given.out)


if __name__ == "__main__":
    main()
