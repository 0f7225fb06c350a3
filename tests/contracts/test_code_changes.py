"""A stage's code is edited between two runs, in a copy that stands for what is installed."""

import ast
import importlib.metadata
import json
import shutil

import pytest

from inpaint3d.contracts.store import FolderStore
from tests.conftest import REPOSITORY, Cli

PACKAGE = "inpaint3d-capture-ingest"
STUB = "src/inpaint3d/stages/capture_ingest/stub.py"


@pytest.fixture
def project(tmp_path):
    ignored = shutil.ignore_patterns("__pycache__", "tests")
    return shutil.copytree(REPOSITORY / "stages" / "capture_ingest", tmp_path / "project", ignore=ignored)


@pytest.fixture
def cli(tmp_path, project):
    """`inpaint3d` where the stage is said to be installed from the copy."""
    metadata = tmp_path / "site" / f"{PACKAGE.replace('-', '_')}-0.1.0.dist-info"
    metadata.mkdir(parents=True)
    (metadata / "METADATA").write_text(importlib.metadata.distribution(PACKAGE).read_text("METADATA") or "")
    (metadata / "direct_url.json").write_text(json.dumps({"url": project.as_uri(), "dir_info": {"editable": True}}))
    return Cli(tmp_path, {"PYTHONPATH": str(tmp_path / "site")})


def edit(project, old, new):
    text = (project / STUB).read_text()
    assert text.count(old) == 1
    (project / STUB).write_text(text.replace(old, new))


def test_why_names_the_file_that_changed_and_a_docstring_is_no_change(cli, project, capture):
    run = ("run", str(capture), "--stub", "--only", "capture-ingest")
    assert cli(*run).returncode == 0
    edit(
        project, '"""Eight views with the ball and three without it."""', '"""Eight  views, and three."""  # a comment'
    )
    assert cli(*run).returncode == 0
    assert cli.statuses()["capture-ingest"] == "cached"

    edit(project, "SIZE = (160, 120)", "SIZE = (160, 121)")
    planned = json.loads(cli("plan", str(capture), "--stub", "--only", "capture-ingest", "--json").stdout)
    (change,) = planned[0]["changes"]
    assert change["component"] == f"code.{PACKAGE}/{STUB}"
    assert cli(*run).returncode == 0
    told = cli("why", "tiny", "capture-ingest").stdout
    assert "changed: code" in told
    assert f'code.{PACKAGE}/{STUB}: "{change["old"]}" -> "{change["new"]}"' in told

    store = FolderStore(cli.store)
    assert len(store.names("code")) == 2
    assert cli("gc", "--keep", "1").returncode == 0
    (record,) = store.records()
    assert store.names("code") == [record.components["code"].removeprefix("sha256:") + ".json"]


SOURCES = [p for folder in ("lib", "stages") for p in sorted(REPOSITORY.glob(f"{folder}/*/src/**/*.py"))]
READERS = {"__doc__", "getdoc", "getsource", "getcomments", "co_firstlineno", "f_lineno"}


def find_readers(source):
    """Lines that read what the digest of code leaves out; the help text of a command line may."""
    helps = {id(n.value) for n in ast.walk(source) if isinstance(n, ast.keyword) and n.arg == "description"}
    named = [n for n in ast.walk(source) if isinstance(n, ast.Name | ast.Attribute) and id(n) not in helps]
    return [n.lineno for n in named if (n.id if isinstance(n, ast.Name) else n.attr) in READERS]


def test_no_stage_computes_with_what_its_digest_leaves_out():
    assert len(SOURCES) > 100
    assert {str(p): lines for p in SOURCES if (lines := find_readers(ast.parse(p.read_text())))} == {}
    assert find_readers(ast.parse("parser(description=__doc__)\nx = len(f.__doc__)")) == [2]
