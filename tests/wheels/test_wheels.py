"""What is installed from wheels runs where there is no checkout, under the keys of one."""

import json
import os
import subprocess
import sys

import pytest

from inpaint3d.contracts.kit.code import list_code
from tests.conftest import REPOSITORY

UV = REPOSITORY / ".cache" / "uv-home" / "bin" / "uv"
LIST_CODE = (
    "import json, sys; from inpaint3d.contracts.kit.code import list_code; print(json.dumps(list_code(sys.argv[1])))"
)


def run_with_uv(command, folder, **environment):
    """Run what calls uv from its cache, which `make install` filled; where that was emptied, from the network."""
    environment = os.environ | {"UV_COMPILE_BYTECODE": "0"} | environment
    cached = subprocess.run(command, cwd=folder, env=environment | {"UV_OFFLINE": "1"}, capture_output=True)
    if cached.returncode != 0:
        subprocess.run(command, cwd=folder, env=environment, check=True)


@pytest.fixture(scope="module")
def python(tmp_path_factory):
    """The interpreter of an environment of others' locked packages and our wheels."""
    folder = tmp_path_factory.mktemp("wheels")
    # The compiler is asked by `make install`: what is tested here needs no kernels.
    build = [sys.executable, REPOSITORY / "wheels" / "build.py", folder / "dist", "-C", "wheel.cmake=false"]
    run_with_uv(build, REPOSITORY)
    others = ("--locked", "--all-packages", "--no-install-workspace", "--no-dev", "--python", sys.executable)
    run_with_uv([UV, "sync", "--quiet", *others], REPOSITORY, UV_PROJECT_ENVIRONMENT=str(folder / "env"))
    found = folder / "env" / "bin" / "python"
    wheels = sorted((folder / "dist").glob("*.whl"))
    run_with_uv([UV, "pip", "install", "--quiet", "--no-deps", "--python", found, *wheels], folder)
    return found


def run_elsewhere(command, folder):
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("INPAINT3D", "PYTHON"))}
    return subprocess.run(command, cwd=folder, env=clean, capture_output=True, text=True)


@pytest.mark.slow
def test_the_whole_pipeline_of_stubs_runs_from_wheels(python, capture, tmp_path):
    (tmp_path / "mask.yaml").write_text("mask: {kind: sphere, centre: [0, 0, 0], radius: 0.3}\n")
    command = [python.with_name("inpaint3d"), "run", capture, "--stub", "--mask", "mask.yaml", "--name", "kitchen"]
    ran = run_elsewhere(command, tmp_path)
    assert ran.returncode == 0, ran.stderr
    results = tmp_path / "runs" / "kitchen"
    assert {"report.html", "scene.usdz", "metrics.json", "pictures"} <= {path.name for path in results.iterdir()}
    again = run_elsewhere(command, tmp_path)
    assert "nothing to be done" in again.stderr, again.stderr


@pytest.mark.slow
def test_the_code_of_a_wheel_counts_as_that_of_its_checkout(python, tmp_path):
    here = list_code("inpaint3d-nerf-pretraining")
    there = json.loads(run_elsewhere([python, "-c", LIST_CODE, "inpaint3d-nerf-pretraining"], tmp_path).stdout)
    # Of what is compiled a wheel has the result in place of the source; this one was built without.
    assert any(name.startswith("inpaint3d-kernels/csrc/") for name in here)
    assert there == {name: digest for name, digest in here.items() if "/csrc/" not in name}
