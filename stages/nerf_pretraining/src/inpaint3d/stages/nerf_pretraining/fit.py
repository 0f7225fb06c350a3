"""The optimisation: random rays of the training views, proposals, field, losses, Adam."""

import math
import time
from typing import NamedTuple

import torch
from torch import Tensor

from inpaint3d.contracts.errors import InterruptedRun, NonFiniteError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.radiance.checkpoints import go_back, load_checkpoint, save_checkpoint
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.health import Health
from inpaint3d.radiance.held_out import HeldOut
from inpaint3d.radiance.line_of_sight import SightLines, line_of_sight_loss
from inpaint3d.radiance.optim import Adam, scheduled_rate
from inpaint3d.radiance.rays import join_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.tracing import NamedCameras, trace_step
from inpaint3d.radiance.training import (
    Pixels,
    descend,
    proposal_anneal,
    rays_at,
    reconstruction,
    regularisers,
)
from inpaint3d.stages.nerf_pretraining.config import Config

CHECKPOINT = "checkpoint.safetensors"
LOOKED_AT = 32  # rays that the counters of health are taken over

CurveRow = list[float]
"""Step, rays so far, mean reconstruction loss since the row before, held-out PSNR in dB (NaN: no held-out view)."""


class Known(NamedTuple):
    """What a field is fitted to: pixels of the training views, and sparse points as these saw them.

    cameras: those of the training views, by name, so that a fault can be traced to one.
    """

    pixels: Pixels
    sight_lines: SightLines | None = None
    cameras: NamedCameras = ()


def fit(field: RadianceField, known: Known, held_out: HeldOut, config: Config, ctx: Context) -> list[CurveRow]:
    """Fit the field to what is known and return the learning curve; goes on exactly from a checkpoint in `ctx.work`.

    A step that is not finite is traced to where it began, and the fit goes back as often as the parameters allow.
    """
    optimizer = Adam.of(field, config.optimizer, config.loss_weights)
    generator = torch.Generator(field.device).manual_seed(ctx.seed)
    tally, health = Tally(), Health()
    path = ctx.work / CHECKPOINT

    def save() -> None:
        save_checkpoint(path, field, optimizer, generator, tally.tensors() | health.tensors())

    def restore(kept: dict[str, Tensor]) -> None:
        tally.restore(kept)
        health.restore(kept)

    if (kept := load_checkpoint(path, field, optimizer, generator)) is None:
        save()  # there is something to go back to from the first step on
    else:
        restore(kept)
    saved = time.monotonic()
    while (step := optimizer.steps) < config.steps:
        try:
            ctx.progress(step, config.steps, "fitting", **tally.latest)
        except InterruptedRun:
            save()
            raise
        drawn = generator.get_state()
        try:
            values, rays = one_step(field, known, optimizer, generator, config, ctx.non_finite)
            tally.add(values["reconstruction"], rays)
            done = step + 1
            if done % config.score_every == 0 or done == config.steps:
                score = held_out.psnr(field, config.block)
                tally.close(done, math.nan if score is None else score)
                ctx.record("learning_curve", **tally.latest)
                health.look(field, known.pixels.draw(LOOKED_AT, torch.Generator().manual_seed(step))[0])
            if done == config.steps or time.monotonic() - saved > config.checkpoint_every_s:
                save()
                saved = time.monotonic()
        except NonFiniteError as error:
            generator.set_state(drawn)
            found = trace_step(field, lambda: step_terms(field, known, step, generator, config)[0], known.cameras)
            told = NonFiniteError(f"{error}; {found}")
            restore(go_back(path, field, optimizer, generator, told, config.optimizer.rollbacks))
            ctx.log(f"{told}; the fit goes on from step {optimizer.steps} with half the learning rate")
    ctx.health |= health.counters(optimizer)
    return tally.curve


def one_step(
    field: RadianceField,
    known: Known,
    optimizer: Adam,
    generator: torch.Generator,
    config: Config,
    non_finite: dict[str, int],
) -> tuple[dict[str, float], int]:
    """One step of the fit: the value of each loss term, and how many rays it took."""
    terms, count = step_terms(field, known, optimizer.steps, generator, config)
    rate = scheduled_rate(optimizer.steps, config.optimizer, config.steps)
    return descend(field, optimizer, terms, rate, non_finite), count


def step_terms(
    field: RadianceField, known: Known, step: int, generator: torch.Generator, config: Config
) -> tuple[dict[str, Tensor], int]:
    """The weighted terms of a step, and how many rays it takes."""
    how, weights = config.optimizer, config.loss_weights
    count = rays_at(step, first=min(config.first_rays, config.rays), last=config.rays, ramp=config.ramp_steps)
    rays, target = known.pixels.draw(count, generator)
    toward = None
    if known.sight_lines and weights.line_of_sight:
        toward = known.sight_lines.draw(config.line_of_sight_rays, generator)
        rays = join_rays([rays, toward.rays])
    # Random background: a field that stays transparent cannot predict it, so that what the photos show becomes opaque.
    background = torch.rand(len(rays.origins), 3, generator=generator, device=generator.device).to(target)
    anneal = proposal_anneal(step, how.proposal_anneal_steps) if how.proposal_anneal_steps else 1.0
    rendering = render(
        field, rays, generator=generator, background=background, anneal=anneal, near_gradient=how.near_gradient
    )
    terms = {
        "reconstruction": reconstruction(rendering.rgb[:count], target, weights.reconstruction),
        **regularisers(rendering, weights),
    }
    if toward is not None:
        terms["line_of_sight"] = weights.line_of_sight * line_of_sight_loss(
            rendering, slice(count, None), toward.distance
        )
    return terms, count


class Tally:
    """The learning curve so far, and what has gone into its next row."""

    def __init__(self) -> None:
        self.curve: list[CurveRow] = []
        self.rays, self.steps, self.loss = 0, 0, 0.0

    @property
    def latest(self) -> dict[str, float]:
        """The last row by column; PSNR is left out where there is none."""
        row = dict(zip(("step", "rays", "loss", "psnr"), self.curve[-1], strict=True)) if self.curve else {}
        return {name: value for name, value in row.items() if not math.isnan(value)}

    def add(self, loss: float, rays: int) -> None:
        self.rays, self.steps, self.loss = self.rays + rays, self.steps + 1, self.loss + loss

    def close(self, step: int, psnr: float) -> None:
        """End a row."""
        self.curve.append([step, self.rays, self.loss / self.steps, psnr])
        self.steps, self.loss = 0, 0.0

    def tensors(self) -> dict[str, Tensor]:
        """For a checkpoint; float64, so that what is restored is what was saved."""
        open_row = torch.tensor([self.rays, self.steps, self.loss], dtype=torch.float64)
        return {"curve": torch.tensor(self.curve, dtype=torch.float64).reshape(-1, 4), "open_row": open_row}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """From a checkpoint."""
        self.curve = [[int(step), int(rays), *rest] for step, rays, *rest in tensors["curve"].tolist()]
        rays, steps, self.loss = tensors["open_row"].tolist()
        self.rays, self.steps = int(rays), int(steps)
