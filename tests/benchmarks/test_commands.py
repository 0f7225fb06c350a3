"""Benchmarks run for hours and seldom: what they import must not go unnoticed when it moves."""

import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY

COMMANDS = sorted(
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__main__")
    for path in (REPOSITORY / "benchmarks").rglob("*.py")
    if '__name__ == "__main__"' in path.read_text() and "peer" not in path.parts
)


@pytest.mark.parametrize("command", COMMANDS)
def test_it_says_how_it_is_used(command):
    told = subprocess.run(
        [sys.executable, "-m", command, "--help"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert told.returncode == 0, told.stderr
    assert "usage:" in told.stdout
