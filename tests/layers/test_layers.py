"""The import contracts of pyproject.toml see what nobody has listed: each rule is broken once, by a scratch member."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY


def lint(folder):
    """`lint-imports` on the installed members and what lies in a folder, which shadows them."""
    line = [str(Path(sys.executable).parent / "lint-imports"), "--no-cache", "--config", "pyproject.toml"]
    environment = {**os.environ, "PYTHONPATH": str(folder), "COLUMNS": "200"}
    return subprocess.run(line, capture_output=True, text=True, check=False, env=environment, cwd=REPOSITORY)


def put_package(folder, name, source):
    """A package of one module; returns the folder to import it from."""
    package = folder.joinpath(*name.split("."))
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(source)
    return folder


def put_module_into(folder, member, source):
    """A copy of an installed library with one module more."""
    name = member.partition("/")[2]
    shutil.copytree(REPOSITORY / member / "src", folder, dirs_exist_ok=True)
    (folder / "inpaint3d" / name / "scratch.py").write_text(source)
    return folder


def test_the_members_as_they_are_keep_every_contract(tmp_path):
    result = lint(put_package(tmp_path, "inpaint3d.stages.relighting", "import inpaint3d.scene.cameras\n"))
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize(
    ("name", "source", "rule", "finding"),
    [
        (
            "inpaint3d.stages.relighting",
            "import inpaint3d.stages.evaluation.boxes\n",
            "no stage imports another BROKEN",
            "inpaint3d.stages.relighting -> inpaint3d.stages.evaluation.boxes",
        ),
        (
            "inpaint3d.stages.relighting",
            "import inpaint3d.orchestrator.plan\n",
            "nothing imports the orchestrator but the client BROKEN",
            "inpaint3d.stages.relighting -> inpaint3d.orchestrator.plan",
        ),
        (
            "inpaint3d.stages.relighting",
            "from inpaint3d import kernels\n",
            "only the native backends import the kernels BROKEN",
            "inpaint3d.stages.relighting -> inpaint3d.kernels",
        ),
        (
            "inpaint3d.lighting",
            "import torch\n",
            "only these import a tensor library BROKEN",
            "inpaint3d.lighting -> torch",
        ),
        ("inpaint3d.lighting", "", "orchestrator knows contracts and report BROKEN", "lighting"),
    ],
)
def test_a_new_member_that_breaks_a_rule_fails(tmp_path, name, source, rule, finding):
    result = lint(put_package(tmp_path, name, source))
    assert result.returncode == 1
    assert rule in " ".join(result.stdout.split())
    assert finding in result.stdout


@pytest.mark.parametrize(
    ("member", "source", "rule"),
    [
        ("lib/contracts", "import torch\n", "contracts, report and the orchestrator compute nothing BROKEN"),
        ("lib/report", "import inpaint3d.contracts.errors\n", "the orchestrator knows contracts and report BROKEN"),
        ("lib/scene", "import torch\n", "only these import a tensor library BROKEN"),
        ("lib/scene", "import inpaint3d.radiance.rays\n", "the orchestrator knows contracts and report BROKEN"),
    ],
)
def test_a_library_that_reaches_above_its_layer_fails(tmp_path, member, source, rule):
    result = lint(put_module_into(tmp_path, member, source))
    assert result.returncode == 1
    assert rule in " ".join(result.stdout.split())
