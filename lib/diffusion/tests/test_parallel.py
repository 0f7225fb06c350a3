import os
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from inpaint3d.diffusion import parallel

SCRIPT = Path(__file__).with_name("parallel_run.py")


def test_two_ranks_learn_what_one_does_from_twice_the_batch(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    one.mkdir()
    two.mkdir()
    alone = runpy.run_path(str(SCRIPT))["learn"](one)
    torchrun = [sys.executable, "-W", "ignore", "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2"]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "GLOO_SOCKET_IFNAME": "lo"}
    subprocess.run([*torchrun, str(SCRIPT), str(two)], check=True, timeout=120, env=environment)
    together = [float(line) for line in (two / "losses.txt").read_text().splitlines()]
    assert together == pytest.approx(alone, rel=1e-6)
    expected = load_file(one / "checkpoint.safetensors")
    for name, value in load_file(two / "checkpoint.safetensors").items():
        # Gradients are summed in another order, which Adam's division magnifies where they are nearly nothing: a step
        # moves a weight by up to 1e-3.
        torch.testing.assert_close(value, expected[name], rtol=1e-4, atol=1e-5, msg=lambda m, n=name: f"{n}: {m}")


def test_one_process_owns_all_parts_and_has_nothing_to_average() -> None:
    parallel.join_ranks()
    assert list(parallel.own_parts(3)) == [0, 1, 2]
    value = torch.ones(2)
    parallel.average_over_ranks([value])
    assert value.tolist() == [1, 1]


def test_parts_that_ranks_cannot_share_equally_are_refused(monkeypatch) -> None:
    monkeypatch.setattr(parallel, "ranks", lambda: 2)
    assert list(parallel.own_parts(4)) == [0, 2]
    with pytest.raises(ValueError, match="3 parts of a batch cannot be shared equally by 2 ranks"):
        parallel.own_parts(3)
