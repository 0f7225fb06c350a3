"""Runs to look at, made once for all tests of pages, and a browser to look with."""

import pytest

from tests.browser import launch
from tests.conftest import Cli

MASK = "mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}\n"


@pytest.fixture(scope="module")
def browser():
    with launch() as launched:
        yield launched


@pytest.fixture(scope="session")
def cli(tmp_path_factory):
    """A run of stubs that went well, `good`; and `bad`, that failed after another of its name had gone well."""
    folder = tmp_path_factory.mktemp("pages")
    (folder / "mask.yaml").write_text(MASK)
    (folder / "capture").mkdir()
    (folder / "capture" / "note.txt").write_text("stubs do not look")
    cli = Cli(folder)
    command = ["run", str(folder / "capture"), "--stub", "--mask", str(folder / "mask.yaml"), "--name"]
    for name in ("good", "bad"):
        assert cli(*command, name).returncode == 0
    wrong = ["run", str(folder / "capture"), "--name", "bad"]  # no stub: there are no pictures in it
    assert cli(*wrong).returncode == 3
    return cli
