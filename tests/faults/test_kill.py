"""Killed at any moment, the next run goes on without a flag, and what is visible is whole."""

import random
import time

import pytest

from inpaint3d.contracts.store import FolderStore


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_kill_9_then_run_again(cli, capture, seed):
    arguments = ("run", str(capture), "--stub", "--until", "nerf-pretraining")
    process = cli.start(*arguments)
    time.sleep(random.Random(seed).uniform(0.3, 3.0))
    process.kill()
    process.wait()
    result = cli(*arguments)
    assert result.returncode == 0, result.stderr
    store = FolderStore(cli.store)
    outputs = [digest for record in store.records() for digest in record.outputs.values()]
    assert len(outputs) >= 4, "capture, posed capture, effect plan, field"
    assert [store.find_damage(digest) for digest in outputs] == [None] * len(outputs)
    assert cli("verify").returncode == 0


def test_sigterm_stops_the_stages_and_the_next_run_goes_on(cli, capture):
    arguments = ("run", str(capture), "--stub", "--until", "nerf-pretraining")
    process = cli.start(*arguments)
    # Before the run has its record it is still being planned, and SIGTERM ends it like any other process.
    while not list((cli.store / "runs").glob("tiny/*.json")):
        assert process.poll() is None, "the run ended before it began"
        time.sleep(0.05)
    process.terminate()
    assert process.wait(timeout=60) in (0, 143)
    assert cli(*arguments).returncode == 0
