"""The views that every part is measured on: posed by the product's own stages, split here, and handed to the peer."""

import json
import math
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import EffectPlan, PosedCapture
from inpaint3d.contracts.store import FolderStore
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.scene.capture_io import View, load_points, load_posed

# Of the list of photos from 0: 3, 10, 17, ... are held out, whatever the stages chose.
FIRST_TEST, EVERY = 3, 7


@dataclass(frozen=True)
class Scene:
    """A posed capture and what the stages found in it."""

    train: list[View]
    test: list[View]
    plan: EffectPlan
    centre_depth: float
    points: NDArray[np.float32]
    sight_lines: SightLines  # by the training views


def run_until(stage: str, capture: Path, repository: Path, folder: Path, *, preset: str = "standard") -> None:
    """Run the pipeline over a capture as far as a stage; its store and results go to `folder`."""
    subprocess.run(
        [
            str(Path(sys.executable).parent / "inpaint3d"), "run", str(capture.resolve()), "--name", "scene",
            "--until", stage, "--preset", preset, "--log-format", "json",
            "--store", str(folder / "store"), "--runs-dir", str(folder / "runs"),
        ],
        cwd=repository, check=True, stdout=sys.stderr,
    )  # fmt: skip


def stages(folder: Path) -> dict[str, dict[str, Any]]:
    """Node -> what the report of the run in a folder says of it."""
    report = json.loads((folder / "runs" / "scene" / "metrics.json").read_text())
    return {stage["node"]: stage for stage in report["stages"]}


def load(folder: Path) -> Scene:
    """The scene that `run_until` left in a folder."""
    found = {node: stage["outputs"] for node, stage in stages(folder).items()}
    store = FolderStore(folder / "store")
    posed = store.open(found["pose-estimation"]["posed-capture"], PosedCapture)
    frames = load_posed(posed)
    views = sorted(frames, key=lambda view: view.name)
    tests = set(range(FIRST_TEST, len(views), EVERY))
    held_out = {view.name for i, view in enumerate(views) if i in tests}
    sparse = load_points(posed.path(posed.metadata.points))
    seen_by_training = np.array([frame.name not in held_out for frame in frames])[sparse.track_frame]
    return Scene(
        train=[replace(view, split="train") for i, view in enumerate(views) if i not in tests],
        test=[replace(view, split="test") for i, view in enumerate(views) if i in tests],
        plan=store.open(found["scene-analysis"]["effect-plan"], EffectPlan).metadata,
        centre_depth=posed.metadata.centre_depth,
        points=sparse.xyz,
        sight_lines=SightLines.of([frame.camera for frame in frames], sparse, seen_by_training),
    )


def write_for_peer(scene: Scene, path: Path, side: int) -> None:
    """Cameras of all views (OpenCV axes), pixels of the training views, and those of the test views that HeldOut takes.

    side: pixels that HeldOut takes along a picture's longest side.
    """
    views = [*scene.train, *scene.test]
    cameras = [view.camera for view in views]
    arrays = {
        "world_from_cam": np.stack([c.world_from_cam for c in cameras]).astype(np.float32),
        "pinhole": np.array([[c.fx, c.fy, c.cx, c.cy] for c in cameras], np.float32),
        "size": np.array([[c.width, c.height] for c in cameras]),
    }
    for name, members, first in (("train", scene.train, 0), ("test", scene.test, len(scene.train))):
        index, yx, rgb = [], [], []
        for i, view in enumerate(members):
            longest = max(view.camera.width, view.camera.height)
            step = max(1, math.ceil(longest / side)) if name == "test" else 1
            real = np.zeros((view.camera.height, view.camera.width), bool)
            real[step // 2 :: step, step // 2 :: step] = view.valid()[step // 2 :: step, step // 2 :: step]
            where = np.argwhere(real)
            index.append(np.full(len(where), first + i))
            yx.append(where)
            rgb.append((view.image()[real] * 255).round().astype(np.uint8))
        arrays |= {
            f"{name}_view": np.concatenate(index),
            f"{name}_yx": np.concatenate(yx).astype(np.int32),
            f"{name}_rgb": np.concatenate(rgb),
        }
    np.savez(path, **arrays, training_views=len(scene.train))
