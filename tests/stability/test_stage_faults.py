"""Inputs of every stage with a number that is not finite: the stage refuses them, naming file and place."""

import json
import re
import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY
from tests.stability.stage_faults import FAULTS

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def told() -> dict[str, tuple[int, str]]:
    """What each fault -> the stage's exit code and message. In a process of its own, which forks the stages."""
    line = [sys.executable, "-W", "ignore", "-m", "tests.stability.stage_faults"]
    made = subprocess.run(line, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout
    return {what: (code, message) for what, code, message in json.loads(made)}


@pytest.mark.parametrize("fault", FAULTS, ids=[f.what for f in FAULTS])
def test_a_stage_names_the_file_and_the_place(fault, told):
    code, message = told[fault.what]
    assert code == 3, message
    assert re.search(fault.said, message), message
