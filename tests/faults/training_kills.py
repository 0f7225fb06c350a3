"""The fit of a small field, killed at random moments until it ends: its weights are those of one that nobody killed.

    python -m tests.faults.training_kills --kills 100 [--seed 0] [--out FILE.json [--add]]

Exits with 1 where they were not, bit for bit, or where a fit could not go on.
"""

import argparse
import collections
import hashlib
import itertools
import os
import random
import signal
import tempfile
import time
from pathlib import Path

from tests.faults.forks import await_until, fork, is_running, wait_for
from tests.faults.kills import NOBODY, Trial
from tests.faults.results import conclude_trials
from tests.stability.test_faults import CONFIG, fit_it, start

STEPS = 40
LONGEST_S = 1.0


def kill_training(folder: Path, rng: random.Random) -> Trial:
    """Kill a fit until it ends, then compare it with one that was left alone."""
    left_alone, killed = folder / "left-alone", folder / "killed"
    for place in (left_alone, killed):
        place.mkdir()
    if code := wait_for(fork(lambda: train(left_alone), folder / "stderr.txt")):
        yield "left alone", f"exit {code}: {(folder / 'stderr.txt').read_text()[-300:]}"
        return
    for attempt in itertools.count():
        if (killed / "weights").exists():
            break
        run = fork(lambda: train(killed), folder / "stderr.txt")
        end = time.monotonic() + rng.uniform(0.1, LONGEST_S + 0.2 * attempt)  # a busy machine gets on, too
        await_until(lambda end=end: time.monotonic() > end, run)
        hit = is_running(run)
        os.kill(run, signal.SIGKILL)
        code = wait_for(run)
        yield "training" if hit else NOBODY, None if code <= 0 else f"exit {code}: {folder / 'stderr.txt'}"
    same = (killed / "weights").read_text() == (left_alone / "weights").read_text()
    yield "and trained to its end", None if same else "other weights than those of the fit that was left alone"


def train(folder: Path) -> None:
    """Fit the field of the stability tests, a checkpoint after every step; leave a digest of its weights."""
    run = start(folder, None, 0)
    fit_it(run, CONFIG.model_copy(update={"steps": STEPS, "checkpoint_every_s": 1e-6}))
    digest = hashlib.sha256()
    for _, parameter in sorted(run.field.named_parameters()):
        digest.update(parameter.detach().numpy().tobytes())
    staged = folder / "weights.new"
    staged.write_text(digest.hexdigest())
    staged.replace(folder / "weights")


def carry_out(kills: int, seed: int) -> tuple[collections.Counter[str], list[str]]:
    """Kill so often: how often whom, and what went wrong."""
    rng, counts, faults = random.Random(seed), collections.Counter[str](), list[str]()
    while counts["killed training"] < kills and not faults:
        with tempfile.TemporaryDirectory() as folder:
            for whom, fault in kill_training(Path(folder), rng):
                counts[f"killed {whom}"] += 1
                faults += [fault] if fault else []
    return counts, faults


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="a JSON file with a section of each of these programs")
    parser.add_argument("--add", action="store_true", help="to what is in the file")
    given = parser.parse_args()
    counts, faults = carry_out(given.kills, given.seed)
    conclude_trials("kills of training", given.seed, counts, faults, given.out, add=given.add)


if __name__ == "__main__":
    main()
