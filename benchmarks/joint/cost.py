"""What a distilled step costs beyond what it must: its own render, forward and backward, and the prior's evaluation.

In CPU seconds of one process: whole steps and their parts in turn, over the same rays and the same patch, so that a
machine that slows down meanwhile slows all of them.
"""

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.diffusion.training import step_generators
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.rays import Rays, camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.training import descend
from inpaint3d.scene.windows import Window
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.guidance import PriorGuide, draw_query
from inpaint3d.stages.joint_optimization.parallel import Ranks
from inpaint3d.stages.joint_optimization.problem import Problem, choose_window
from inpaint3d.stages.joint_optimization.run import pose
from inpaint3d.stages.joint_optimization.schedule import TimestepRange

STEPS, WARM_UP = 24, 4
RATE = 1e-3


def sds_step(inputs: Inputs, *, guidance: float) -> dict[str, Any]:
    """Medians over steps, CPU seconds: a whole step of score distillation, its render, the prior; and their ratio."""
    torch.set_num_threads(1)
    estimator = {"name": "sds", "guidance": guidance, "distill_every": 1, "centre_steps": 0}
    config = Config.model_validate({"estimator": estimator})
    problem, _ = pose(config, inputs, 0, "cpu")
    guide = problem.guide
    if not isinstance(guide, PriorGuide):
        raise TypeError(f"score distillation is guided by a prior, not by {type(guide).__name__}")
    works = (_steps(problem), lambda step: _render(problem, step), lambda step: _ask(guide, guidance, step))
    turns = [[_take_cpu_seconds(work, step) for work in works] for step in range(WARM_UP + STEPS)]
    whole, shown, asked = (statistics.median(times) for times in zip(*turns[WARM_UP:], strict=True))
    return {
        "step_cpu_s": whole,
        "render_cpu_s": shown,
        "prior_cpu_s": asked,
        "evaluations": 1 if guidance in (0.0, 1.0) else 2,
        "ratio": whole / (shown + asked),
    }


def _take_cpu_seconds(work: Callable[[int], None], step: int) -> float:
    start = time.process_time()
    work(step)
    return time.process_time() - start


def _steps(problem: Problem) -> Callable[[int], None]:
    optimizer = Adam(problem.field, hash_decay=problem.config.loss_weights.hash_decay)

    def work(step: int) -> None:
        # One step on, since the first has no weight yet and so no distillation term.
        terms, _ = problem.terms(step + 1, Ranks())
        descend(problem.field, optimizer, terms, RATE, {})

    return work


def _render(problem: Problem, step: int) -> None:
    """Every ray of a step: random ones, depth patches and the hole with gradients, the patch's known part without."""
    config, field = problem.config, problem.field
    rng, generator = step_generators(problem.seed, step + 1)
    window = _window(problem, step + 1, rng)
    view = problem.to_fill[window.view]
    rays = camera_rays(view.camera, window.pixels())
    hole = torch.from_numpy(window.sample(view.hole))
    batch = problem.bank.draw(
        config.rays, patches=config.depth_patches, patch_size=config.depth_patch_size, generator=generator
    )
    with torch.no_grad():
        render(field, Rays(rays.origins[~hole], rays.directions[~hole]), glo="mean")
    inside = Rays(rays.origins[hole], rays.directions[hole])
    render(field, batch.rays, generator=generator, near_gradient=False).rgb.mean().backward()
    render(field, inside, generator=generator, glo="mean", near_gradient=False).rgb.mean().backward()
    field.zero_grad()


def _window(problem: Problem, step: int, rng: np.random.Generator) -> Window:
    if problem.guided is None:
        raise ValueError("nothing is distilled without a guide")
    guide, estimator = problem.guided
    span = estimator.span_at(step, problem.config.steps)
    return choose_window(problem.to_fill, guide, estimator, since=step, span=span, rng=rng)


def _ask(guide: PriorGuide, guidance: float, step: int) -> None:
    prior = guide.prior
    generator = torch.Generator().manual_seed(step)
    size = guide.size
    hole = torch.zeros(size, size, dtype=torch.bool)
    hole[size // 4 : 3 * size // 4, size // 4 : 3 * size // 4] = True
    patch, times = torch.rand(size, size, 3, generator=generator), TimestepRange(0.5, 0.6, floored=False)
    query = draw_query(patch, hole, times, generator, prior.latent_shape)
    if query.eps is None:
        raise ValueError("a drawn query has noise")
    with torch.no_grad():
        prior.predict_noise(query.eps, query.t, query.x, query.mask, guidance=guidance, noise_fill=query.noise_fill)
