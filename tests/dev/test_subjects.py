"""What `.ci/check_subjects` says of a commit message."""

import subprocess

import pytest

from tests.conftest import REPOSITORY


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("A" * 72 + "\n\nA body of any length" + "." * 100 + "\n", 0),
        ("# a comment of the editor's, which is longer than seventy-two characters are\nA subject\n", 0),
        ("A" * 73 + "\n", 2),
        ("A subject with a full stop.\n", 2),
    ],
)
def test_a_long_subject_or_a_full_stop_is_refused(tmp_path, message, code):
    (tmp_path / "message").write_text(message)
    line = [str(REPOSITORY / ".ci" / "check_subjects"), str(tmp_path / "message")]
    result = subprocess.run(line, capture_output=True, text=True, check=False)
    assert result.returncode == code
    assert ("reword it" in result.stderr) == bool(code)
