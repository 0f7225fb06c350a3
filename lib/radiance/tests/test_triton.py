"""Triton's kernels, interpreted on the processor where Triton is installed."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).with_name("triton_run.py")


@pytest.mark.skipif(importlib.util.find_spec("triton") is None, reason="Triton is not installed (it comes with CUDA)")
def test_kernels_are_the_reference_s() -> None:
    """In a process of its own: whether Triton interprets is settled when kernels are imported."""
    interpreted = os.environ | {"TRITON_INTERPRET": "1"}
    done = subprocess.run([sys.executable, str(RUN)], capture_output=True, text=True, env=interpreted)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["hash_encode", "mlp", "adam"]
