"""What a GPU gives this project: `python -m benchmarks.gpu --device cuda --minutes 9 --corpus CORPUS --out FOLDER`.

Three parts, each in a process of its own with a deadline of its own, so that none can stop another:

    correctness   every path that runs on the device against the processor
    rates         of the machine, of the field by each backend, and of the prior; a scene's quality in time
    prior         trains the prior of 128 pixels for the rest of the time, from --prior where that is given

FOLDER/results.json holds each figure as soon as it is there, FOLDER/log.txt what was said; the prior's weights lie in
pieces of at most --piece-mib (`python -m benchmarks.gpu.pieces FOLDER PRIOR` makes an artifact of them).
--device cpu runs the same here; --tiny takes sizes that need seconds. For a machine without a network: `make pack-gpu`.
"""

import argparse
import importlib
import multiprocessing
import os
import platform
import signal
import sys
import time
import traceback
from pathlib import Path
from typing import Any

from benchmarks.gpu.results import Results

PARTS = ("correctness", "rates", "prior")
SHARES = {"correctness": 0.15, "rates": 0.25, "prior": 0.6}
"""Of the time. What a part leaves, those after it get."""
GRACE_S = 10.0
"""A part that has not ended so long after its deadline is killed."""


def main() -> None:
    options = arguments()
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out / "results.json"
    results.unlink(missing_ok=True)
    end = time.monotonic() + 60 * options.minutes
    with Log(options.out / "log.txt"):
        import_ahead()
        Results(results, "machine", end).attempt("machine", lambda: describe_machine(options.device))
        failed = [part for part in options.parts if not run_part(part, options, results, end)]
    print(f"{results}: {', '.join(options.parts)}" + (f"; failed: {', '.join(failed)}" if failed else ""))
    sys.exit(1 if failed else 0)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cuda")
    parser.add_argument("--minutes", type=float, default=9.0, help="of all parts together")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS))
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--corpus", type=Path, nargs="*", default=[], help="image-corpus artifacts; without: noise")
    parser.add_argument("--prior", type=Path, help="diffusion-prior artifact to go on from; its spec is taken")
    parser.add_argument("--scene", type=Path, help="folder with posed-capture and effect-plan; without: a made-up room")
    parser.add_argument("--piece-mib", type=float, default=15.0, help="largest piece of the weights")
    parser.add_argument("--tiny", action="store_true", help="sizes that need seconds on a processor")
    return parser.parse_args()


def import_ahead() -> None:
    """What all parts import, once; no device is touched. What cannot be imported, the part that wants it says."""
    for name in ("torch._dynamo", *(f"benchmarks.gpu.{part}" for part in PARTS)):
        try:
            importlib.import_module(name)
        except Exception:
            traceback.print_exc()


def run_part(part: str, options: argparse.Namespace, results: Path, end: float) -> bool:
    """One part in a process; whether it ended well and in time."""
    left = end - time.monotonic()
    later = sum(SHARES[p] for p in options.parts if PARTS.index(p) >= PARTS.index(part))
    until = time.monotonic() + left * SHARES[part] / later
    # Forked before any device is touched: what is imported already need not be imported again.
    process = multiprocessing.get_context("fork").Process(target=_run, args=(part, options, results, until))
    process.start()
    process.join(max(until - time.monotonic(), 0) + GRACE_S)
    if process.is_alive():
        os.killpg(process.pid, signal.SIGKILL)  # with those that cut pictures or compile for it
        process.join()
        Results(results, part, until).put("stopped", "it was not done at its deadline")
        return False
    if process.exitcode:
        Results(results, part, until).put("stopped", f"exit code {process.exitcode}; see log.txt")
    return process.exitcode == 0


def _run(part: str, options: argparse.Namespace, results: Path, until: float) -> None:
    os.setpgrp()
    importlib.import_module(f"benchmarks.gpu.{part}").measure(options, Results(results, part, until))


def describe_machine(device: str) -> dict[str, Any]:
    """What the figures are of."""
    import torch

    found: dict[str, Any] = {
        "python": platform.python_version(),
        "torch": torch.__version__,
        "cores": os.cpu_count(),
        "processor": platform.processor() or platform.machine(),
        "device": device,
    }
    if device == "cuda":
        # Asked in a process of its own: a forked one cannot use a device that its parent has touched.
        asked = "import torch; p = torch.cuda.get_device_properties(0); print(p.name, p.total_memory, sep='|')"
        name, memory = os.popen(f'{sys.executable} -c "{asked}"').read().strip().rpartition("|")[::2]
        found |= {"gpu": name, "gpu_memory_bytes": int(memory)}
    return found


class Log:
    """Everything that this process and its children say, into a file too."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> None:
        self.own = os.dup(1), os.dup(2)
        file = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
        sys.stdout.flush()
        os.dup2(file, 1)
        os.dup2(file, 2)

    def __exit__(self, *_: object) -> None:
        sys.stdout.flush()
        for kept, standard in zip(self.own, (1, 2), strict=True):
            os.dup2(kept, standard)
        print(self.path.read_text()[-8000:])


if __name__ == "__main__":
    main()
