"""`inpaint3d dev new-stage` in a copy of a checkout's declarations: what it writes passes the contract suite."""

import ast
import json
import os
import shutil
import subprocess
import sys

import pytest
import yaml

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.dev_cli import new_stage, register_schema, wire
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """The pipeline, the declarations of its stages, the contracts; and in it the new stage `relighting`."""
    folder = tmp_path_factory.mktemp("checkout")
    for path in ("pipeline.yaml", *(str(p.relative_to(REPOSITORY)) for p in REPOSITORY.glob("stages/*/stage.yaml"))):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / path, folder / path)
    shutil.copytree(REPOSITORY / "lib" / "contracts" / "src", folder / "lib" / "contracts" / "src")
    for path in ("priors", "schemas"):
        (folder / path).symlink_to(REPOSITORY / path)
    new_stage("relighting", reads="nerf-pretraining.radiance-field", writes="relit-views",
              description="Renders under another light", pipeline=folder / "pipeline.yaml")  # fmt: skip
    return folder


def install(checkout):
    """Say that the new package is installed from its source, as `make install` would; the folder that says it."""
    said = checkout / "installed" / "inpaint3d_relighting-0.1.0.dist-info"
    said.mkdir(parents=True, exist_ok=True)
    (said / "METADATA").write_text("Name: inpaint3d-relighting\nVersion: 0.1.0\nRequires-Dist: inpaint3d-contracts\n")
    url = (checkout / "stages" / "relighting").as_uri()
    (said / "direct_url.json").write_text(json.dumps({"url": url, "dir_info": {"editable": True}}))
    return said.parent


def run(checkout, *line):
    sources = [checkout / "lib" / "contracts" / "src", checkout / "stages" / "relighting" / "src", install(checkout)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, sources))}
    return subprocess.run(
        [sys.executable, *line], capture_output=True, text=True, check=False, env=environment, cwd=checkout
    )


def test_the_new_stage_passes_the_contract_suite_and_its_own_tests(checkout):
    result = run(
        checkout, "-m", "pytest", "-q", "--import-mode=importlib", "-p", "no:cacheprovider", "stages/relighting"
    )
    assert result.returncode == 0, result.stdout
    assert "passed" in result.stdout
    assert "skipped" not in result.stdout


def test_the_new_files_are_as_the_linter_wants_them(checkout):
    ruff = ["-m", "ruff", "check", "--config", str(REPOSITORY / "pyproject.toml"), "stages"]
    result = run(checkout, *ruff)
    assert result.returncode == 0, result.stdout


def test_the_pipeline_differs_by_the_new_node_alone(checkout):
    before, after = ((folder / "pipeline.yaml").read_text() for folder in (REPOSITORY, checkout))
    documents = [yaml.safe_load(text) for text in (before, after)]
    assert documents[1]["spec"]["stages"].pop() == {
        "name": "relighting",
        "stage": "stages/relighting",
        "inputs": {"radiance-field": "nerf-pretraining.radiance-field"},
    }
    assert documents[1]["spec"]["wants"].pop() == "relighting"
    assert documents[0] == documents[1]
    changed = set(before.splitlines()) - set(after.splitlines())
    assert all(line.lstrip().startswith("wants: [") for line in changed), "comments too stay as they are"


def test_a_node_is_added_wherever_the_stages_end(tmp_path):
    path = tmp_path / "pipeline.yaml"
    path.write_text("spec:\n  stages:\n    - name: a\n      inputs: {}\n\n  # The last.\n  defaultPreset: b\n")
    wire(path, "c", "c", "x", "a.x")
    assert yaml.safe_load(path.read_text())["spec"]["stages"][1] == {
        "name": "c", "stage": "stages/c", "inputs": {"x": "a.x"}}  # fmt: skip
    assert path.read_text().endswith("\n\n  # The last.\n  defaultPreset: b\n")


@pytest.mark.parametrize("wants", ["  wants: [a]  # of a run\n", "  wants:\n    - a\n", ""])
def test_a_new_node_is_wanted_where_wants_are_named(tmp_path, wants):
    """Else nothing would read its result, and it would never run."""
    path = tmp_path / "pipeline.yaml"
    path.write_text(f"spec:\n  stages:\n    - name: a\n      inputs: {{}}\n{wants}  defaultPreset: b\n")
    wire(path, "c", "c", "x", "a.x")
    read = yaml.safe_load(path.read_text())["spec"]
    assert read.get("wants") == (["a", "c"] if wants else None)
    assert [node["name"] for node in read["stages"]] == ["a", "c"]
    assert read["defaultPreset"] == "b"


def test_a_schema_is_named_three_times(tmp_path):
    registry = tmp_path / "inpaint3d" / "contracts" / "models" / "artifacts" / "__init__.py"
    registry.parent.mkdir(parents=True)
    before = """from inpaint3d.contracts.models.artifacts.a import (
    A,
)
from inpaint3d.contracts.models.base import Closed

SCHEMAS: dict[str, tuple[str, type[Closed]]] = {
    "a": ("1.0", A),
}

__all__ = [
    "A",
]
"""
    registry.write_text(before)
    register_schema(registry, "relit_views", "RelitViews", "relit-views")
    added = [line for line in registry.read_text().splitlines() if line not in before.splitlines()]
    assert added == [
        "from inpaint3d.contracts.models.artifacts.relit_views import RelitViews",
        '    "relit-views": ("1.0", RelitViews),',
        '    "RelitViews",',
    ]
    without = "".join(line for line in registry.read_text().splitlines(keepends=True) if line.rstrip("\n") not in added)
    assert without == before
    assert ast.parse(registry.read_text()).body[1].module == "inpaint3d.contracts.models.artifacts.relit_views"


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("Relighting", {}, "'Relighting' is no name for a stage"),
        ("relighting", {"writes": "capture"}, "the artifact capture has a schema already"),
        ("relighting", {"reads": "nerf-pretraining.field"}, "there are .*nerf-pretraining.radiance-field"),
        ("evaluation", {"writes": "relit-views"}, "evaluation is there already"),
    ],
)
def test_what_cannot_be_is_refused_and_nothing_is_written(tmp_path, name, options, message):
    shutil.copy(REPOSITORY / "pipeline.yaml", tmp_path / "pipeline.yaml")
    for folder in ("stages", "lib", "schemas", "priors"):
        (tmp_path / folder).symlink_to(REPOSITORY / folder)
    reads = options.pop("reads", "nerf-pretraining.radiance-field")
    with pytest.raises(ConfigurationError, match=message):
        new_stage(name, reads=reads, description="D", pipeline=tmp_path / "pipeline.yaml", **options)
    assert (tmp_path / "pipeline.yaml").read_text() == (REPOSITORY / "pipeline.yaml").read_text()
    assert Pipeline(tmp_path / "pipeline.yaml").order
