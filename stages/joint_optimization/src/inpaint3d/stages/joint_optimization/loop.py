"""The paper's loop: what a step's loss is made of, and the steps, checkpoints and curves around it (rows S1 to S12)."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch

from inpaint3d.contracts.errors import BadInputError, InterruptedRun
from inpaint3d.contracts.kit.context import Context
from inpaint3d.diffusion.training import step_generators
from inpaint3d.radiance.checkpoints import load_checkpoint, save_checkpoint
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.optim import Adam, learning_rate
from inpaint3d.radiance.training import descend, proposal_anneal
from inpaint3d.stages.joint_optimization.batch import Filled, RayBank
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.distil import Distilled, distil
from inpaint3d.stages.joint_optimization.guidance import Guide
from inpaint3d.stages.joint_optimization.held_out import HeldOut
from inpaint3d.stages.joint_optimization.objective import Terms, decay_term, gradient_norms, step_terms
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.patches import Window, centre_views, draw_window
from inpaint3d.stages.joint_optimization.scene import Scene, SceneView, distillable
from inpaint3d.stages.joint_optimization.schedule import (
    TimestepRange,
    centre_views_only,
    distillation_weight,
    specular_scale,
    terms_due,
    timestep_range,
    window_span,
)

CHECKPOINT_INTERVAL_S = 30.0
GUIDE = "guide."


@dataclass(frozen=True, eq=False)
class Problem:
    """What is optimised, and by what.

    to_fill: the training views with the holes that the guide is to fill. fresh: the field starts from nothing, and
    needs steps of reconstruction alone (S7).
    """

    field: RadianceField
    guide: Guide | None
    scene: Scene
    to_fill: Sequence[SceneView]
    config: Config
    seed: int
    fresh: bool
    diffuse_start: bool
    filled: Filled | None = None

    @cached_property
    def bank(self) -> RayBank:
        device, share = str(self.field.device), self.config.filled_share
        sightings = self.scene.sightings(device)
        return RayBank(self.scene.train, device, filled=self.filled, filled_share=share, sightings=sightings)

    def since(self, step: int) -> int:
        """Steps since the start of distillation (S6, S8); negative before it, and throughout without a guide."""
        return -1 if self.guide is None else step - (self.config.warmup_steps if self.fresh else 0)

    def rate(self, step: int) -> float:
        """The learning rate of a step (N7)."""
        config = self.config
        return (1.0 if self.fresh else config.carried_rate) * learning_rate(
            step,
            initial=config.learning_rate,
            final=config.final_learning_rate,
            steps=config.learning_rate_steps or config.steps,
            warmup=config.learning_rate_warmup,
        )

    def terms(self, step: int, ranks: Ranks) -> tuple[Terms, dict[str, float]]:
        """The weighted terms of a rank at a step, and how strongly the prior pushed.

        They depend on the field, the guide, (seed, step, rank) and nothing else: that a run was stopped and went on, or
        how its ranks share out, never shows.
        """
        config = self.config
        rng, generator = step_generators(self.seed * ranks.count + ranks.rank, step)
        distilled, weight, figures = self._distilled(step, rng, generator)
        batch = self.bank.draw(
            config.rays // ranks.count,
            patches=config.depth_patches if config.depth_weight else 0,
            patch_size=config.depth_patch_size,
            generator=generator,
            sighted=max(1, config.sight_rays // ranks.count) if config.sight_weight else 0,
        )
        anneal = proposal_anneal(step, config.proposal_anneal_steps) if self.fresh else 1.0
        terms = step_terms(self.field, batch, distilled, weight, config, anneal=anneal, generator=generator)
        return terms, figures

    def _distilled(
        self, step: int, rng: np.random.Generator, generator: torch.Generator
    ) -> tuple[Distilled | None, float, dict[str, float]]:
        config, since = self.config, self.since(step)
        if self.guide is None or since < 0 or since % config.distill_every:
            return None, 0.0, {}
        total, schedule = config.steps - (step - since), config.schedule_steps or config.steps
        timesteps = timestep_range(
            step, schedule, t_min=config.t_min, t_max=config.t_max, width=config.t_width, floor=config.t_floor
        )
        weight = distillation_weight(
            since, total, peak=config.weight, warmup=config.weight_warmup, decay_to=config.weight_decay_to
        )
        span = self.guide.span or window_span(since, total, first=config.span_first, last=config.span_last)
        specular = specular_scale(step, schedule) if self.diffuse_start else 1.0
        window = choose_window(self.to_fill, self.guide, config, since=since, span=span, rng=rng)
        distilled = distil(
            self.field,
            self.guide,
            self.to_fill[window.view],
            window,
            timesteps=timesteps[:2],
            specular_scale=specular,
            block=config.block,
            generator=generator,
        )
        return distilled, weight, prior_figures(distilled, timesteps, weight, span, specular)


def optimise(problem: Problem, ctx: Context, curves: Curves, ranks: Ranks) -> None:
    """All steps. Interrupted, it leaves a checkpoint from which the next call goes on exactly.

    Every rank calls it; the first one keeps the checkpoint, and what it decides all do at the same step.
    """
    field, config = problem.field, problem.config
    held_out = HeldOut(problem.scene.test, config.score_pixels, str(field.device))
    optimizer = Adam(
        field,
        network_scale=config.network_rate_share,
        hash_decay=config.hash_decay_weight,
        sparse=config.sparse_adam,
        before_step=lambda: ranks.average(field.parameters()),
    )
    # A checkpoint holds a stream; here every step has its own.
    unused = torch.Generator()
    checkpoint = ctx.work / "checkpoint.safetensors"
    ranks.hand_out(checkpoint)
    if (kept := load_checkpoint(checkpoint, field, optimizer, unused)) is not None:
        curves.restore(kept)
        if problem.guide is not None:
            problem.guide.restore({n.removeprefix(GUIDE): t for n, t in kept.items() if n.startswith(GUIDE)})
    saved = time.monotonic()
    rays_a_step = config.rays + ranks.count * config.depth_patches * config.depth_patch_size**2
    while (step := optimizer.steps) < config.steps:
        stopped: InterruptedRun | None = None
        try:
            ctx.progress(step, config.steps, "optimising")
        except InterruptedRun as interruption:
            stopped = interruption
        stop, save = ranks.agreed(stopped is not None, time.monotonic() - saved > CHECKPOINT_INTERVAL_S)
        if (stop or save) and ranks.rank == 0:
            learnt = {} if problem.guide is None else problem.guide.state()
            extra = curves.tensors() | {GUIDE + name: tensor for name, tensor in learnt.items()}
            save_checkpoint(checkpoint, field, optimizer, unused, extra)
            saved = time.monotonic()
        if stop:
            raise stopped or InterruptedRun("the first rank was stopped")
        terms, figures = problem.terms(step, ranks)
        last = step + 1 == config.steps
        due = terms_due(step, problem.since(step), config.terms_every, config.distill_every)
        norms = gradient_norms(field, terms | decay_term(field, config)) if last or due else None
        losses = descend(field, optimizer, terms, problem.rate(step), ctx.non_finite)
        if norms is not None:
            curves.add_terms(step + 1, losses, norms, **figures)
        if ranks.rank == 0 and (last or (step + 1) % config.score_every == 0):
            psnr = held_out.psnr(field, config.block)
            loss = sum(value for name, value in losses.items() if name != "distillation")
            curves.add_point(step + 1, (step + 1) * rays_a_step, loss, psnr)
            ctx.record("learning_curve", step=step + 1, loss=loss, **({} if psnr is None else {"psnr": psnr}))


def choose_window(
    shown: Sequence[SceneView], guide: Guide, config: Config, *, since: int, span: float, rng: np.random.Generator
) -> Window:
    """A view that shows the hole (a centre view at first, S8) and a window of it."""
    views = distillable(shown)
    if centre_views_only(since, config.centre_steps):
        centres = np.stack([shown[i].camera.centre for i in views])
        shares = np.array([shown[i].hole_share for i in views])
        views = [views[i] for i in centre_views(centres, shares, config.centre_views)]
    chosen = views[int(rng.integers(len(views)))]
    view = shown[chosen]
    window = (
        draw_window(view.hole, view.known, chosen, size=guide.size, span=span, least_known=config.least_known, rng=rng)
        if guide.windows is None
        else guide.windows[chosen]
    )
    if window is None:
        raise BadInputError(f"view {view.name} has no hole to fill; re-run mask-authoring")
    return window


def prior_figures(
    distilled: Distilled, timesteps: TimestepRange, weight: float, span: float, specular: float
) -> dict[str, float]:
    """How and how strongly the prior pushed at a step, for terms.csv."""
    return {
        "weight": weight,
        "t": distilled.t,
        "t_low": timesteps.low,
        "t_high": timesteps.high,
        "t_floored": float(timesteps.floored),
        "push": distilled.push,
        "window_span": span,
        "specular_scale": specular,
    }
