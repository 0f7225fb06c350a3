"""The paper's loop: steps, checkpoints and curves around what a step descends (rows S11, S12)."""

import time

import torch
from torch import Tensor

from inpaint3d.contracts.errors import InterruptedRun, NonFiniteError
from inpaint3d.contracts.kit.checkpoints import find_checkpoint
from inpaint3d.contracts.kit.context import Context
from inpaint3d.radiance.checkpoints import go_back, load_checkpoint, save_checkpoint
from inpaint3d.radiance.health import Health, check_finite
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.tracing import trace_step
from inpaint3d.radiance.training import descend
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.objective import decay_term, gradient_norms
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.problem import Problem
from inpaint3d.stages.joint_optimization.schedule import terms_due

CHECKPOINT_INTERVAL_S = 30.0
LOOKED_AT = 32  # rays that the counters of health are taken over
GUIDE = "guide."


def optimise(problem: Problem, ctx: Context, curves: Curves, ranks: Ranks) -> None:
    """All steps. Interrupted, it leaves a checkpoint from which the next call goes on exactly.

    Every rank calls it; the first one keeps the checkpoint, and what it decides all do at the same step.
    """
    field, config = problem.field, problem.config
    held_out = HeldOut.at_random(
        [KnownPhoto(v.camera, v.image, v.known) for v in problem.scene.test], config.score_pixels, field.device
    )
    optimizer = Adam.of(
        field, config.optimizer, config.loss_weights, before_step=lambda: ranks.average(field.parameters())
    )
    # A checkpoint holds a stream; here every step has its own.
    unused, health = torch.Generator(), Health()
    checkpoint = ctx.work / "checkpoint.safetensors"
    if ranks.rank == 0 and (whole := find_checkpoint(checkpoint)) is not None:
        whole.replace(checkpoint)
    ranks.broadcast_file(checkpoint)

    def save() -> None:
        learnt = {} if problem.guide is None else problem.guide.state()
        extra = curves.tensors() | health.tensors() | {GUIDE + name: tensor for name, tensor in learnt.items()}
        save_checkpoint(checkpoint, field, optimizer, unused, extra)

    def restore(kept: dict[str, Tensor]) -> None:
        curves.restore(kept)
        health.restore(kept)
        if problem.guide is not None:
            problem.guide.restore({n.removeprefix(GUIDE): t for n, t in kept.items() if n.startswith(GUIDE)})

    if (kept := load_checkpoint(checkpoint, field, optimizer, unused)) is not None:
        restore(kept)
    elif ranks.rank == 0:
        save()  # there is something to go back to from the first step on
    # What one rank alone meets it cannot go back from by itself: the others are steps ahead.
    rollbacks = config.optimizer.rollbacks if ranks.world_size == 1 else 0
    saved = time.monotonic()
    while (step := optimizer.steps) < config.steps:
        stopped: InterruptedRun | None = None
        try:
            ctx.progress(step, config.steps, "optimising")
        except InterruptedRun as interruption:
            stopped = interruption
        stop, due = ranks.agree(stopped is not None, time.monotonic() - saved > CHECKPOINT_INTERVAL_S)
        try:
            if (stop or due) and ranks.rank == 0:
                save()
                saved = time.monotonic()
            if stop:
                raise stopped or InterruptedRun("the first rank was stopped")
            _take_step(problem, ctx, curves, ranks, optimizer, held_out, health)
        except NonFiniteError as error:
            found = trace_step(field, lambda: problem.terms(step, ranks)[0], problem.cameras)
            told = NonFiniteError(f"{error}; {found}")
            restore(go_back(checkpoint, field, optimizer, unused, told, rollbacks))
            ctx.log(f"{told}; the optimisation goes on from step {optimizer.steps} with half the learning rate")
    ctx.health |= health.counters(optimizer)


def _take_step(
    problem: Problem, ctx: Context, curves: Curves, ranks: Ranks, optimizer: Adam, held_out: HeldOut, health: Health
) -> None:
    """One step, its rows of the curves, and after the last one a look at every weight."""
    field, config, step = problem.field, problem.config, optimizer.steps
    distill_every = problem.guided[1].distill_every if problem.guided else 1
    terms, figures = problem.terms(step, ranks)
    last = step + 1 == config.steps
    due = terms_due(step, problem.since(step), config.terms_every, distill_every)
    norms = gradient_norms(field, terms | decay_term(field, config)) if last or due else None
    losses = descend(field, optimizer, terms, problem.rate(step), ctx.non_finite)
    if last:
        check_finite(field, optimizer)
    if norms is not None:
        curves.add_terms(step + 1, losses, norms, **figures)
    if ranks.rank == 0 and (last or (step + 1) % config.score_every == 0):
        psnr = held_out.psnr(field, config.block)
        loss = sum(value for name, value in losses.items() if name != "distillation")
        curves.add_point(step + 1, (step + 1) * problem.count_rays(ranks), loss, psnr)
        ctx.record("learning_curve", step=step + 1, loss=loss, **({} if psnr is None else {"psnr": psnr}))
        health.look(field, problem.bank.look(LOOKED_AT, torch.Generator().manual_seed(step)))
