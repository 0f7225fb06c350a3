"""A small field with the effects of a plan, fitted to a made capture: how well it shows the clean test views."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from benchmarks.effects.captures import MadeCapture, PlanFolder

from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import Effect, EffectPlan
from inpaint3d.radiance.architecture import Architecture
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.evidence_masks import IgnoredPixels
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, fit

SMALL = Architecture(levels=6, finest=256, log2_table=14, channels=2, samples=16, proposal_samples=(24,))
CENTRE_DEPTH = 0.85


@dataclass(frozen=True)
class Score:
    """psnr: dB against the clean test views; cpu_s: of the fit."""

    psnr: float
    cpu_s: float


def plan_with(plan: PlanFolder, on: frozenset[str]) -> PlanFolder:
    """The plan with exactly these effects on, and what they take out of the evidence."""
    effects = [Effect(name=name, state="on", evidence={}, reason="switched by the study") for name in sorted(on)]
    ignored = tuple(one for one in plan.metadata.ignored if one.effect in on)
    return PlanFolder(EffectPlan(effects=tuple(effects), ignored=ignored), plan.root)


def score(made: MadeCapture, plan: PlanFolder, work: Path, *, steps: int, rays: int, seed: int = 0) -> Score:
    """Fit a field under a plan."""
    torch.set_num_threads(1)
    work.mkdir(parents=True)
    config = Config(steps=steps, rays=rays, first_rays=rays, architecture=SMALL, score_every=steps)
    ctx = Context(seed=seed, device="cpu", threads=1, work=work, emit=lambda *_, **__: None)
    train, test = made.train, made.test
    spec = field_spec(SMALL, plan.metadata, views=len(train), centre_depth=CENTRE_DEPTH, points=made.points.xyz)
    field = RadianceField(spec, seed)
    ignored = IgnoredPixels(plan)
    known = [ignored.take_from(view.valid(), view.name, view.camera) for view in train]
    pixels = Pixels.of([view.camera for view in train], [view.image() for view in train], known)
    seen = np.array([view.split == "train" for view in made.views])[made.points.track_frame]
    lines = SightLines.of([view.camera for view in made.views], made.points, seen, "cpu")
    photos = [
        KnownPhoto(view.camera, clean, np.ones(clean.shape[:2], bool))
        for view, clean in zip(test, made.clean, strict=True)
    ]
    begun = time.process_time()
    fit(field, Known(pixels, lines), HeldOut([]), config, ctx)
    cpu_s = time.process_time() - begun
    psnr = HeldOut.at_random(photos, 2500, "cpu").psnr(field, 4096)
    return Score(float("nan") if psnr is None else psnr, cpu_s)
