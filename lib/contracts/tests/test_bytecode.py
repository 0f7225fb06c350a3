"""What counts as a change of a Python file: what it runs, and nothing else."""

import os
import subprocess
import sys

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.bytecode import digest_python

SOURCE = '''"""A module."""

import math

NAMES = {"a", "b", "c"}
"""An attribute's docstring."""


class Lens:
    """A lens."""

    focal: float = 2.0

    def scale(self, x, *, power=1):
        """Scaled."""
        if x in {"near", "far", "mid"}:  # a set that the compiler folds
            return (x, 0.5, -0.0)
        return [math.sin(y) ** power for y in range(3)]


async def wait():
    """Wait."""
    try:
        return f"{math.pi:.3f}"
    except ValueError:
        return None
'''


def digest(folder, source):
    path = folder / "lens.py"
    path.write_text(source)
    return digest_python(path)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""A module."""', '"""A  module: more words."""\n# and a comment'),
        ('"""An attribute\'s docstring."""', '"""An attribute\'s  docstring."""'),
        ('"""A lens."""', '"""A\n    lens\n    of three lines."""'),
        ('        """Scaled."""\n', ""),
        ('    """Wait."""\n', ""),
        ('"""A lens."""', "# no docstring"),
        ('"""An attribute\'s docstring."""\n', ""),
        ("        return None\n", '        """Nothing."""\n        return None\n'),
        ("import math\n", "import math\n\n\n\n"),
        ("  # a set that the compiler folds", ""),
        ("power=1", "power = 1"),
        ("(x, 0.5, -0.0)", "(\n                x,\n                0.50,\n                -0.0,\n            )"),
    ],
)
def test_what_runs_the_same_has_the_same_digest(tmp_path, old, new):
    assert SOURCE.replace(old, new) != SOURCE
    assert digest(tmp_path, SOURCE.replace(old, new)) == digest(tmp_path, SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("0.5", "0.25"),
        ("-0.0", "0.0"),
        ("range(3)", "range(4)"),
        ("math.sin", "math.cos"),
        ("power=1", "power=1.0"),
        ("power=1", "power=True"),
        ("*, power", "power"),
        ('"near", "far"', '"near", "Far"'),
        ("focal: float", "focal: int"),
        ("focal: float = 2.0", "focal: float = 3.0"),
        ("class Lens", "class Mirror"),
        (".3f", ".4f"),
        ("ValueError", "TypeError"),
        ("async def", "def"),
        ("[math.sin(y) ** power for y in range(3)]", "{math.sin(y) ** power for y in range(3)}"),
        ('{"a", "b", "c"}', '{"a", "b"}'),
    ],
)
def test_what_runs_otherwise_has_another_digest(tmp_path, old, new):
    assert SOURCE.replace(old, new) != SOURCE
    assert digest(tmp_path, SOURCE.replace(old, new)) != digest(tmp_path, SOURCE)


def test_every_process_and_every_folder_give_the_same_digest(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    expected = digest(tmp_path, SOURCE)
    assert digest(tmp_path / "elsewhere", SOURCE) == expected
    code = "import sys, pathlib; from inpaint3d.contracts.kit.bytecode import digest_python as d; "
    line = [sys.executable, "-c", code + "print(d(pathlib.Path(sys.argv[1])))", str(tmp_path / "lens.py")]
    for seed in "0123":
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        printed = subprocess.run(line, capture_output=True, text=True, check=True, env=environment).stdout
        assert printed.strip() == expected


def test_a_file_that_is_not_python_is_named_with_its_line(tmp_path):
    with pytest.raises(ConfigurationError, match=r"lens\.py:2: .*repair the file"):
        digest(tmp_path, "x = 1\ny = = 2\n")


def make_old(path):
    """As a file is that was changed a while ago: what is kept of it is believed."""
    os.utime(path, (1_000_000_000, 1_000_000_000))


def test_a_digest_is_kept_until_the_file_changes(tmp_path):
    path = tmp_path / "lens.py"
    path.write_text(SOURCE)
    make_old(path)
    first = digest_python(path)
    (kept,) = (tmp_path / "__pycache__").iterdir()
    kept.write_text(kept.read_text().replace(first, "sha256:" + "0" * 64))
    assert digest_python(path) == "sha256:" + "0" * 64, "it was compiled again"
    path.write_text(SOURCE + "x = 1\n")
    make_old(path)
    assert digest_python(path) not in (first, "sha256:" + "0" * 64)


def test_a_file_that_has_just_changed_is_compiled_each_time(tmp_path):
    first = digest(tmp_path, "x = 1\n")
    assert not (tmp_path / "__pycache__").exists()
    assert digest(tmp_path, "x = 2\n") != first
