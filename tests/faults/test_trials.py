"""Small samples of `make test-faults`."""

import json
import subprocess
import sys

from tests.conftest import REPOSITORY
from tests.faults import beside_gc, fuzz
from tests.faults.kills import VICTIMS


def test_nothing_is_lost_half_there_or_wrong():
    line = [sys.executable, "-W", "ignore", "-m", "tests.faults.trials", "--kills", "3", "--corruptions", "60"]
    told = subprocess.run([*line, "--seed", "1"], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert told.returncode == 0, told.stdout + told.stderr
    counts = json.loads(told.stdout)["kills and corruptions"]["trials"]
    assert sum(n for what, n in counts.items() if what.startswith("corrupted")) == 60
    assert sum(n for what, n in counts.items() if what.removeprefix("killed ") in (*VICTIMS, "group")) >= 3
    assert counts["killed and run to its end"] >= 1
    kinds = ("checkpoint", "database", "key", "lock", "object", "record")
    assert {f"corrupted {kind}" for kind in kinds} < set(counts)


def test_trials_are_added_to_those_before_them(tmp_path):
    out = tmp_path / "reliability.json"
    line = [sys.executable, "-W", "ignore", "-m", "tests.faults.trials", "--kills", "0", "--corruptions", "3", "--add"]
    for seed in ("1", "2"):
        subprocess.run([*line, "--seed", seed, "--out", str(out)], cwd=REPOSITORY, capture_output=True, check=True)
    made = json.loads(out.read_text())["kills and corruptions"]
    assert made["seeds"] == [1, 2]
    assert sum(made["trials"].values()) == 6


def test_damaged_inputs_are_read_or_refused_and_nothing_else(tmp_path):
    counts, faults = fuzz.fuzz(count=900, seed=1, folder=tmp_path)
    assert faults == []
    assert {"YAML", "ONNX", "checkpoint", "EXR"} < set(counts)
    assert all(outcomes["refused"] for outcomes in counts.values())
    assert sum(outcomes["read"] for outcomes in counts.values()) > 0


def test_runs_and_stages_whose_write_fails_end_as_documented_and_go_on():
    line = [sys.executable, "-W", "ignore", "-m", "tests.faults.write_sites", "--errors", "ENOSPC", "EMFILE", "KILL"]
    told = subprocess.run(
        [*line, "--first", "5", "--last", "5"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert told.returncode == 0, told.stdout + told.stderr
    writes = json.loads(told.stdout)["write sites"]["writes"]
    assert writes == {f"{kind} {error}": 1 for kind in ("run", "stage") for error in ("ENOSPC", "EMFILE", "KILL")}


def test_gc_takes_nothing_from_those_who_commit(tmp_path):
    counts, faults = beside_gc.carry_out(tmp_path, processes=3, results=10)
    assert faults == []
    assert counts["gc ran"] > 0
