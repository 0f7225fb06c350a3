"""The ways a stage can be started, for tests that hold for all of them."""

import shutil
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from inpaint3d.contracts.models.cluster import ImagesSpec
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.pipeline import Pipeline
from tests.conftest import REPOSITORY

PIPELINE = Pipeline(REPOSITORY / "pipeline.yaml")
BUILT = REPOSITORY / ".cache" / "images.yaml"


def environment_of(runner: str, folder: Path) -> dict[str, str]:
    """What `inpaint3d` has to be told in its environment for a runner: process, engine (a pretended one), podman."""
    if runner == "process":
        return {}
    if runner == "podman":
        if reason := why_no_podman():
            pytest.skip(reason)
        return {"INPAINT3D_RUNNER": "container", "INPAINT3D_ENGINE": "podman", "INPAINT3D_IMAGES": str(BUILT)}
    engine, images = folder / "engine", folder / "images.yaml"
    engine.write_text(f'#!/bin/sh\nexec {sys.executable} {REPOSITORY / "tests" / "engine.py"} "$@"\n')
    engine.chmod(engine.stat().st_mode | stat.S_IXUSR)
    spec = {
        s.spec.image: {"image": f"images.example/{s.spec.image}:1", "digest": "sha256:" + "ab" * 32}
        for s in PIPELINE.stages.values()
    }
    images.write_text(yaml.safe_dump({"apiVersion": "inpaint3d/v1", "kind": "Images", "spec": spec}))
    return {
        "INPAINT3D_RUNNER": "container",
        "INPAINT3D_ENGINE": str(engine),
        "INPAINT3D_IMAGES": str(images),
        "ENGINE_LOG": str(folder / "engine.log"),
    }


def why_no_podman() -> str | None:
    """Why the images cannot be run here, or None."""
    if shutil.which("podman") is None:
        return "there is no podman here"
    if not BUILT.is_file():
        return "no images were built here (`make images`)"
    built = load_document(BUILT, ImagesSpec)[0].spec
    for stage in PIPELINE.stages.values():
        image = built.get(stage.spec.image)
        if image is None or subprocess.run(["podman", "image", "exists", image.image], check=False).returncode != 0:
            return f"the image of {stage.metadata.name} was not built here (`make images`)"
    return None
