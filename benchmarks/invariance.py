"""Fits of the synthetic room moved, scaled and turned, and of ten times the steps: `python -m benchmarks.invariance`.

The room's cameras and points go through what pose estimation does with known cameras: a local frame, rounding, the
normalised world. What is scored are photos that were held out, depth where the truth is known, and the masks that a
quarter of them gives the other views. Captures with a few sparse points far away are fitted too.
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
from inpaint3d.contracts.models.artifacts.masks import ImportedRequest
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.rendering import render_view
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.geometry import Similarity, rotation_between
from inpaint3d.scene.image_io import write_mask
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.mask_authoring.author import author
from inpaint3d.stages.mask_authoring.config import Config as MaskConfig
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.segment import iou
from inpaint3d.stages.mask_authoring.views import DepthView
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
FAR_AWAY = 50.0  # median distances of the points
GIVEN_EVERY = 4  # views whose masks are given
WORLDS = {
    "as it is": (1.0, 0.0, UP),
    "moved 1e3": (1.0, 1e3, UP),
    "moved 1e7": (1.0, 1e7, UP),
    "scaled 1e-6": (1e-6, 0.0, UP),
    "scaled 1e6": (1e6, 0.0, UP),
    "turned": (1.0, 0.0, (1.0, -2.0, 0.5)),
    "all three": (300.0, 1e7, (1.0, -2.0, 0.5)),
}
FAR = {"1.5 % of the points far away": 0.015, "5 % of the points far away": 0.05}


def cameras_of(scene: SyntheticScene, world: str) -> tuple[list[Camera], NDArray[np.float32], float]:
    """The room's cameras and points in the normalised world of a moved one, and its centre depth."""
    scale, shift, up = WORLDS.get(world, WORLDS["as it is"])
    moved = Similarity(scale, rotation_between(UP, up), shift * np.array([0.5, 1.0, 0.01]))
    poses = np.stack([moved.pose(camera.world_from_cam) for camera in scene.cameras])
    local = find_local_frame(poses[:, :, 3])
    poses = np.stack([round_pose(local.pose(pose)) for pose in poses])
    xyz = round_points(local.points(moved.points(move_away(scene.points.xyz, FAR.get(world, 0.0)))))
    found = normalise(poses, xyz, 0)
    there = found.normalised_from_source
    cameras = [
        Camera(c.fx, c.fy, c.cx, c.cy, c.width, c.height, there.pose(pose))
        for c, pose in zip(scene.cameras, poses, strict=True)
    ]
    return cameras, there.points(xyz).astype(np.float32), found.centre_depth


def move_away(points: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """The points [n, 3] with a share of them far away, each in its own direction."""
    chosen = np.random.default_rng(0).permutation(len(points))[: round(share * len(points))]
    middle = np.median(points, axis=0)
    offsets = points[chosen] - middle
    distance = np.median(np.linalg.norm(points - middle, axis=1))
    moved = points.copy()
    moved[chosen] = middle + FAR_AWAY * distance * offsets / np.linalg.norm(offsets, axis=1, keepdims=True)
    return moved


def score(scene: SyntheticScene, world: str, seed: int, steps: int) -> dict[str, float]:
    """Held-out PSNR (dB) and median relative depth error of a fit, and the mean IoU of masks that it carries."""
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
    iou_of_masks = measure_masks(scene, field, cameras)
    return {"psnr": round(psnr, 2), "depth_error": round(float(np.mean(errors)), 4), "mask_iou": round(iou_of_masks, 3)}


def measure_masks(scene: SyntheticScene, field: RadianceField, cameras: list[Camera]) -> float:
    """Mean IoU of the masks that a hull gives the views in between, where every fourth has its own."""
    depth_views = [
        DepthView(name, camera, render_view(field, camera)["median_depth"], lambda image=image: image)
        for name, camera, image in zip(scene.names, cameras, scene.images, strict=True)
    ]
    with tempfile.TemporaryDirectory() as work:
        views: list[View] = []
        for i, (view, mask) in enumerate(zip(depth_views, scene.object_masks, strict=True)):
            path = Path(work) / f"{view.name}.png"
            write_mask(path, mask)
            views.append(View(view.name, view.camera, "train", None, path, path if i % GIVEN_EVERY == 0 else None))
        ctx = Context(seed=0, device="cpu", threads=1, work=Path(work), emit=_ignore)
        request = ImportedRequest.model_validate({"kind": "imported"})
        made = author(request, Scene(views, depth_views, [], ordered=True), 0.0, MaskConfig(), ctx)
    pairs = zip(made.masks, scene.object_masks, strict=True)
    return float(np.mean([iou(mask, truth) for i, (mask, truth) in enumerate(pairs) if i % GIVEN_EVERY]))


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
        for world in (*WORLDS, *FAR):
            result["worlds"][world] = score(scene, world, 0, STEPS)
            print(world, result["worlds"][world], flush=True)
    RESULTS.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
