"""The same faults done to three systems: runs killed at a random moment, bits flipped in what a run has made.

python -m benchmarks.peer_faults --dvc FILE --snakemake FILE [--kills 20] [--flips 20] [--out FILE.json]

The graph is that of `benchmarks.overhead`, with three stages in its middle. After a kill (SIGKILL of the whole group)
the same command is run again, and where it fails, once more after what the system's own message or manual tells to do
(`help_out`). After a flipped bit, with the file's times as before (a disk that rots tells nobody), the same command is
run again, and what every stage made is held against an undisturbed run.
"""

import argparse
import collections
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.overhead import System, version_of, write_dvc, write_ours, write_snakemake
from benchmarks.provenance import commit

WIDTH = 3
LONGEST_S = {"inpaint3d": 2.5, "dvc": 4.0, "snakemake": 4.0}
"""A run takes about as long."""
Write = Callable[[Path], System]
Counts = collections.Counter[str]


def list_outputs(system: System) -> list[Path]:
    """The files that the stages made, wherever the system keeps them."""
    if system.name == "inpaint3d":
        return sorted((system.folder / "store" / "objects").glob("*/number.txt"))
    names = ["first", "last", *(f"spread-{i}" for i in range(WIDTH))]
    return [path for name in names if (path := system.folder / name).is_file()]


def read_outputs(system: System) -> list[bytes]:
    """What the stages made, in an order that does not depend on where it is kept."""
    return sorted(path.read_bytes() for path in list_outputs(system))


def start(system: System, *extra: str) -> subprocess.CompletedProcess[bytes]:
    line = [*system.command, *extra]
    return subprocess.run(line, cwd=system.folder, env=system.environment, capture_output=True, check=False)


def try_kill(system: System, expected: list[bytes], rng: random.Random) -> str:
    """What became of a run that was killed and run again."""
    process = subprocess.Popen(
        system.command, cwd=system.folder, env=system.environment, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    time.sleep(rng.uniform(0.2, LONGEST_S[system.name]))
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    again = start(system)
    if again.returncode == 0:
        return "went on" if read_outputs(system) == expected else "wrong result"
    return "went on after a person's help" if help_out(system).returncode == 0 else "stuck"


def help_out(system: System) -> subprocess.CompletedProcess[bytes]:
    """The run again, after what a person is told to do: take away a lock that nobody holds, redo what is half done."""
    if system.name == "snakemake":
        start(system, "--unlock")
        return start(system, "--rerun-incomplete")
    for lock in ("rwlock", "lock", "rwlock.lock"):
        (system.folder / ".dvc" / "tmp" / lock).unlink(missing_ok=True)
    return start(system)


def try_flip(system: System, expected: list[bytes], rng: random.Random) -> str:
    """What became of a bit that was flipped in what a whole run had made."""
    start(system)
    path = rng.choice(list_outputs(system))
    before = path.stat()
    data = bytearray(path.read_bytes())
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    path.chmod(0o644)
    path.write_bytes(data)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    path.chmod(before.st_mode & 0o777)
    again = start(system)
    if again.returncode != 0:
        return "found, not mended"
    # What was put in quarantine is no output any more, what was computed again is.
    return "found and mended" if read_outputs(system) == expected else "unnoticed"


def compare(writers: dict[str, Write], kills: int, flips: int, seed: int) -> dict[str, dict[str, Counts]]:
    """System -> fault -> what became of it -> how often."""
    rng = random.Random(seed)
    results: dict[str, dict[str, Counts]] = {name: {"killed": Counts(), "bit flipped": Counts()} for name in writers}
    for name, write in writers.items():
        with tempfile.TemporaryDirectory() as scratch:
            undisturbed = write(Path(scratch))
            start(undisturbed)
            expected = read_outputs(undisturbed)
        for fault, trial, count in (("killed", try_kill, kills), ("bit flipped", try_flip, flips)):
            for _ in range(count):
                with tempfile.TemporaryDirectory() as scratch:
                    results[name][fault][trial(write(Path(scratch)), expected, rng)] += 1
    return results


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dvc", type=Path, required=True)
    parser.add_argument("--snakemake", type=Path, required=True)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--flips", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    dvc, snakemake = given.dvc.absolute(), given.snakemake.absolute()
    writers: dict[str, Write] = {
        "inpaint3d": lambda folder: write_ours(folder, WIDTH),
        "dvc": lambda folder: write_dvc(folder, dvc, WIDTH),
        "snakemake": lambda folder: write_snakemake(folder, snakemake, WIDTH),
    }
    figures = {
        "stages": WIDTH + 2,
        "versions": {"dvc": version_of(dvc), "snakemake": version_of(snakemake)},
        "seed": given.seed,
        "systems": compare(writers, given.kills, given.flips, given.seed),
    }
    text = json.dumps(figures | commit(), indent=2) + "\n"
    sys.stdout.write(text)
    if given.out is not None:
        given.out.write_text(text)


if __name__ == "__main__":
    main()
