"""Fits of the synthetic room moved, scaled and turned, and of ten times the steps: `python -m benchmarks.invariance`.

The room's cameras and points go through what pose estimation does with known cameras: a local frame, rounding, the
normalised world. What is scored are photos that were held out, and depth where the truth is known.
"""

import argparse
import json
import tempfile
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import EffectPlan
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.rendering import render_view
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.geometry import Similarity, rotation_between
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, fit
from inpaint3d.stages.pose_estimation.model import round_points, round_pose
from inpaint3d.stages.pose_estimation.normalise import find_local_frame, normalise

RESULTS = Path(__file__).parent / "results/invariance.json"
HELD_OUT = (3, 7, 11)
STEPS = 300
SIZE = {
    "levels": 6, "finest": 128, "log2_table": 13, "samples": 16, "proposal_samples": [24], "proposal_levels": 4,
    "proposal_finest": 64, "proposal_log2_table": 12, "density_width": 32, "view_width": 16, "view_layers": 1,
}  # fmt: skip
UP = (0.0, 0.0, 1.0)
WORLDS = {
    "as it is": (1.0, 0.0, UP),
    "moved 1e3": (1.0, 1e3, UP),
    "moved 1e7": (1.0, 1e7, UP),
    "scaled 1e-6": (1e-6, 0.0, UP),
    "scaled 1e6": (1e6, 0.0, UP),
    "turned": (1.0, 0.0, (1.0, -2.0, 0.5)),
    "all three": (300.0, 1e7, (1.0, -2.0, 0.5)),
}


def cameras_of(scene: SyntheticScene, world: str) -> tuple[list[Camera], NDArray[np.float32], float]:
    """The room's cameras and points in the normalised world of a moved one, and its centre depth."""
    scale, shift, up = WORLDS[world]
    moved = Similarity(scale, rotation_between(UP, up), shift * np.array([0.5, 1.0, 0.01]))
    poses = np.stack([moved.pose(camera.world_from_cam) for camera in scene.cameras])
    local = find_local_frame(poses[:, :, 3])
    poses = np.stack([round_pose(local.pose(pose)) for pose in poses])
    xyz = round_points(local.points(moved.points(scene.points.xyz)))
    found = normalise(poses, xyz, 0)
    there = found.normalised_from_source
    cameras = [
        Camera(c.fx, c.fy, c.cx, c.cy, c.width, c.height, there.pose(pose))
        for c, pose in zip(scene.cameras, poses, strict=True)
    ]
    return cameras, there.points(xyz).astype(np.float32), found.centre_depth


def score(scene: SyntheticScene, world: str, seed: int, steps: int) -> dict[str, float]:
    """Held-out PSNR (dB) and median relative depth error of a fit."""
    cameras, points, depth = cameras_of(scene, world)
    config = Config.model_validate({
        "architecture": SIZE, "steps": steps, "rays": 192, "first_rays": 192, "ramp_steps": 0, "score_every": steps,
        "checkpoint_every_s": 3600.0,
    })  # fmt: skip
    spec = field_spec(config.architecture, EffectPlan(effects=()), views=16, centre_depth=depth, points=points)
    train = [i for i in range(len(cameras)) if i not in HELD_OUT]
    field = RadianceField(spec, seed)
    pixels = Pixels.of([cameras[i] for i in train], [scene.images[i] for i in train], [None] * len(train))
    shown = np.ones(scene.images[0].shape[:2], bool)
    held_out = HeldOut.on_lattice([KnownPhoto(cameras[i], scene.images[i], shown) for i in HELD_OUT], 48, "cpu")
    with tempfile.TemporaryDirectory() as work:
        ctx = Context(seed=seed, device="cpu", threads=1, work=Path(work), emit=_ignore)
        fit(field, Known(pixels), held_out, config, ctx)
    errors = []
    for i in HELD_OUT:
        truth = scene.depths[i] * np.linalg.norm(cameras[i].centre) / np.linalg.norm(scene.cameras[i].centre)
        errors.append(np.median(np.abs(render_view(field, cameras[i])["median_depth"] / truth - 1)))
    psnr = held_out.psnr(field, 4096)
    assert psnr is not None
    return {"psnr": round(psnr, 2), "depth_error": round(float(np.mean(errors)), 4)}


def _ignore(event: str, **values: object) -> None:
    """Nobody listens."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--long", action="store_true", help="ten times the steps, beside the fits of usual length")
    parser.add_argument("--seeds", type=int, default=2)
    options = parser.parse_args()
    torch.set_num_threads(1)
    scene = synthetic_scene(views=16)
    result = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    if options.long:
        result["long"] = {str(n): score(scene, "as it is", 0, n) for n in (STEPS, 10 * STEPS)}
        print(result["long"], flush=True)
    else:
        result["seeds"] = [score(scene, "as it is", seed, STEPS) for seed in range(options.seeds)]
        print(result["seeds"], flush=True)
        result["worlds"] = {}
        for world in WORLDS:
            result["worlds"][world] = score(scene, world, 0, STEPS)
            print(world, result["worlds"][world], flush=True)
    RESULTS.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
