"""A field under way: of the made-up room, or of a scene that was posed before."""

import time
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from benchmarks.provenance import REPOSITORY

from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, PosedCapture
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.store import load_artifact
from inpaint3d.radiance import backends
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.scene.synthetic import SyntheticScene, synthetic_scene
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, one_step

TINY: dict[str, Any] = {
    "architecture": {
        "levels": 4, "finest": 64, "log2_table": 12, "samples": 16, "proposal_samples": [16], "proposal_levels": 3,
        "proposal_finest": 32, "proposal_log2_table": 10, "density_width": 32, "view_width": 32, "view_layers": 2,
    },
    "rays": 256, "first_rays": 256, "ramp_steps": 0, "optimizer": {"learning_rate_warmup": 5},
}  # fmt: skip
EVERY = 6
"""Of the room's views every so many is held out."""


class Fit:
    """A field, what it is fitted to, and what it is judged by."""

    def __init__(
        self, config: Config, spec: Any, known: Known, held_out: HeldOut, device: str, backend: backends.Name | None
    ) -> None:
        self.config, self.known, self.held_out = config, known, held_out
        self.field = RadianceField(spec, 0, backend).to(device)
        self.optimizer = Adam.of(self.field, config.optimizer, config.loss_weights)
        self.generator = torch.Generator(self.field.device).manual_seed(0)

    def step(self) -> None:
        one_step(self.field, self.known, self.optimizer, self.generator, self.config, {})

    def psnr(self) -> float:
        """On the held-out views, dB."""
        return self.held_out.psnr(self.field, self.config.block) or 0.0


def preset(name: str) -> Config:
    """nerf-pretraining's parameters under a preset of pipeline.yaml."""
    return Config.model_validate(Pipeline(REPOSITORY / "pipeline.yaml").parameters("nerf-pretraining", name))


def room_fit(device: str, *, tiny: bool, config: Config | None = None, backend: backends.Name | None = None) -> Fit:
    """A field of the made-up room."""
    config = config or (Config.model_validate(TINY) if tiny else preset("standard"))
    room = _room(12, 48, 36) if tiny else _room(36, 320, 240)
    train = [i for i in range(len(room.names)) if i % EVERY]
    plan = EffectPlan(effects=tuple(_effect(name) for name in ("contraction", "exposure", "view-dependence")))
    spec = field_spec(
        config.architecture, plan, views=len(train), centre_depth=0.85, points=room.points.xyz
    )  # fmt: skip
    everywhere = np.ones(room.images.shape[1:3], bool)
    pixels = Pixels.of(
        [room.cameras[i] for i in train], [room.images[i] for i in train], [None] * len(train), device
    )  # fmt: skip
    photos = [KnownPhoto(room.cameras[i], room.images[i], everywhere) for i in range(len(room.names)) if i not in train]
    return Fit(config, spec, Known(pixels), HeldOut.on_lattice(photos, 48, device), device, backend)


@cache
def _room(views: int, width: int, height: int) -> SyntheticScene:
    return synthetic_scene(views, width, height)


def _effect(name: str) -> Effect:
    return Effect(name=name, state="on", evidence={}, reason="a benchmark")


def scene_fit(folder: Path, device: str, config: Config, backend: backends.Name | None = None) -> Fit:
    """A field of a scene: the artifacts posed-capture and effect-plan in a folder."""
    posed = load_artifact(folder / "posed-capture", "posed-capture@1", PosedCapture)
    plan = load_artifact(folder / "effect-plan", "effect-plan@1", EffectPlan).metadata
    views = load_posed(posed)
    train = [view for view in views if view.split == "train"]
    test = [view for view in views if view.split == "test"]
    points = load_points(posed.path(posed.metadata.points))
    spec = field_spec(
        config.architecture, plan, views=len(train), centre_depth=posed.metadata.centre_depth, points=points.xyz
    )
    pixels = Pixels.of([v.camera for v in train], [v.image() for v in train], [v.valid() for v in train], device)
    seen = np.array([view.split == "train" for view in views])[points.track_frame]
    sight_lines = SightLines.of([view.camera for view in views], points, seen, device) if seen.any() else None
    held_out = HeldOut.on_lattice(map(KnownPhoto.of, test), config.score_side, device)
    return Fit(config, spec, Known(pixels, sight_lines), held_out, device, backend)


def fit_for(fit: Fit, steps: int) -> float:
    """Held-out PSNR after so many steps, dB."""
    for _ in range(steps):
        fit.step()
    return fit.psnr()


def wait_for(device: str) -> float:
    """The time, seconds, once the device has done all that it was told."""
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()
