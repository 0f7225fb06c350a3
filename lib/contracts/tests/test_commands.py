"""Commands besides a stage's run end with the documented codes, however they end."""

import os
import signal
import subprocess
import sys

import pytest

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.commands import exit_on_error

PROGRAM = """
import os, signal, sys
from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.commands import carry_out_confined

def end(how):
    if how == "error":
        raise BadInputError("a.png is cut short")
    if how != "done":
        os.kill(os.getpid(), getattr(signal, how))
        signal.pause()

carry_out_confined(lambda: end(sys.argv[1]), with_parent=False)
"""


@pytest.mark.parametrize(("how", "code"), [("done", 0), ("error", 3), ("SIGINT", 0), ("SIGTERM", 143)])
def test_a_command_ends_with_its_code_however_it_ends(how: str, code: int) -> None:
    told = subprocess.run([sys.executable, "-c", PROGRAM, how], capture_output=True, text=True, check=False, timeout=60)
    assert told.returncode == code, told.stderr
    assert told.stderr == ("inpaint3d: bad input: a.png is cut short\n" if how == "error" else "")


@pytest.mark.parametrize(
    ("error", "code"), [(BadInputError("a.png is cut short"), 3), (OSError(28, os.strerror(28), "a"), 5)]
)
def test_a_foreseen_error_is_one_line_and_its_code(error: Exception, code: int, capsys) -> None:
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(SystemExit) as left, exit_on_error("corpus"):
        raise error
    assert left.value.code == code
    assert capsys.readouterr().err.startswith("corpus: ")
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_bug_stays_one() -> None:
    with pytest.raises(KeyError), exit_on_error():
        raise KeyError("nobody foresaw it")
