"""The lesson, the training loop and the exam: the same for a capture's prior and for one of a corpus alone."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from inpaint3d.contracts.errors import ConfigurationError, NonFiniteError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import PriorSpec
from inpaint3d.diffusion.judging import fill_each_way, hole_psnr
from inpaint3d.diffusion.parallel import own_parts, rank
from inpaint3d.diffusion.prior import InpaintingPrior, bf16_pays
from inpaint3d.diffusion.training import (
    Batch,
    TrainingState,
    begin,
    denoising_loss,
    load_checkpoint,
    rate_after_warm_up,
    save_checkpoint,
    step_generators,
    train_step,
)
from inpaint3d.perception.lpips import enlarge, load
from inpaint3d.scene.finite import NonFinite, find_non_finite
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.psnr import mean_psnr
from inpaint3d.stages.diffusion_training.ahead import make_ahead
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.pictures import Cropper, Picture

CHECKPOINT_S = 20.0
MOST_LOST = 3
"""Steps in a row that may be lost to numbers that are not finite."""
EXAM_SEED = 2**31 - 1


@dataclass(frozen=True, eq=False)
class Lesson:
    """What is taught, and the exam afterwards."""

    capture: Sequence[Picture]
    corpus: Sequence[Picture]
    cropper: Cropper
    exam: Batch


def lesson_of(
    config: Config,
    spec: PriorSpec,
    training: Sequence[Picture],
    held_out: Sequence[Picture],
    corpus: Sequence[Picture] = (),
    shapes: Sequence[Mask] = (),
    device: torch.device | str = "cpu",
) -> Lesson:
    """shapes: the capture's own masks. device: where the exam is held. Raises ConfigurationError where there are no
    shapes and no other hole is wanted.
    """
    if not shapes and config.masks.own == 1:
        raise ConfigurationError("masks.own is 1 but there are no masks with a usable shape; set another mix")
    cropper = Cropper(spec.size, config.crop_share, config.masks, shapes, config.whole_share, config.enlarged)
    rng = np.random.default_rng(EXAM_SEED)
    exam = cropper.batch([held_out[i % len(held_out)] for i in range(config.exam)], rng)
    return Lesson(training, corpus, cropper, exam.to(device))


def begin_or_resume(
    config: Config, spec: PriorSpec, start: InpaintingPrior | None, ctx: Context, checkpoint: Path
) -> TrainingState:
    """The state that training starts with, or the one that it was stopped in."""
    bf16 = config.precision == "bf16" or (config.precision == "auto" and bf16_pays(ctx.device))
    channels_last = config.channels_last or ctx.device != "cpu"
    state = begin(spec, ctx.seed, start, bf16=bf16, channels_last=channels_last, device=ctx.device)
    if config.compiled:
        state.prior.network.compile()
    if load_checkpoint(checkpoint, state):
        ctx.log(f"going on from step {state.step}")
    return state


def train(
    state: TrainingState, config: Config, lesson: Lesson, ctx: Context, checkpoint: Path, *, fine_tuning: bool
) -> None:
    """The loop: crops with holes, one step, a row of the curve now and then, a checkpoint at least every minute.

    Of several ranks each does this; the first one writes the checkpoint.
    """
    peak = config.fine_tuning_rate if fine_tuning else config.learning_rate
    every = max(1, config.steps // config.curve_rows)
    saved = ctx.elapsed()[0]
    draw = partial(draw_batches, lesson, config, ctx.seed, own_parts(config.parts))
    steps = make_ahead(draw, range(state.step, config.steps), ctx.device)
    for batches in steps:
        losses = [
            partial(denoising_loss, batch=batch.to(ctx.device), generator=generator, t_range=config.t_range)
            for batch, generator in zip(batches, _make_noise_generators(config, ctx, state.step), strict=True)
        ]
        rate = rate_after_warm_up(peak, state.step, config.steps, config.warm_up)
        loss = train_step(state, *losses, learning_rate=rate, ema=config.ema)
        if not np.isfinite(loss):
            count_lost_step(state, ctx)
        if state.step % every == 0 or state.step == config.steps:
            state.close_row(_measure_held_out_loss(state, config, lesson.exam))
            step, mean, held_out = state.curve[-1]
            ctx.record(
                "training_curve", step=step, loss=mean, held_out_loss=held_out, waited_s=round(steps.waited_s, 3)
            )
        if rank() == 0 and (ctx.stopping or ctx.elapsed()[0] - saved > CHECKPOINT_S):
            save_checkpoint(checkpoint, state)
            saved = ctx.elapsed()[0]
        ctx.progress(state.step, config.steps, "training the prior", loss=loss)


def draw_batches(lesson: Lesson, config: Config, seed: int, parts: Sequence[int], step: int) -> list[Batch]:
    """The pictures of some parts of a step's batch, decoded and cut."""
    batches: list[Batch] = []
    for part in parts:
        rng, _ = step_generators(seed, step, part)
        batches.append(lesson.cropper.batch(_draw_pictures(lesson, config, rng), rng))
    return batches


def _make_noise_generators(config: Config, ctx: Context, step: int) -> list[torch.Generator]:
    """What the noise of each part of a step that is this rank's is drawn from, on the device."""
    return [step_generators(ctx.seed, step, part, ctx.device)[1] for part in own_parts(config.parts)]


def count_lost_step(state: TrainingState, ctx: Context) -> None:
    """A step that was not finite and moved nothing: counted, told, and from the third in a row on an error.

    One alone may be an overflow of bfloat16. Raises NonFiniteError, which names step and tensors.
    """
    ctx.non_finite["training_loss"] = ctx.non_finite.get("training_loss", 0) + 1
    gradients = {f"gradient of {n}": p.grad for n, p in state.prior.named_parameters() if p.grad is not None}
    weights: dict[str, Tensor] = dict(state.prior.named_parameters())
    found = [*_find_non_finite(weights), *_find_non_finite(gradients)]
    where = f"step {state.step} of the prior's training was not finite: {', '.join(map(str, found[:3]))}"
    lost = next((i for i, loss in enumerate(reversed(state.pending)) if math.isfinite(loss)), len(state.pending))
    if lost >= MOST_LOST or _find_non_finite(weights):
        raise NonFiniteError(f"{where}; {lost} steps in a row moved nothing, the last checkpoint is kept in {ctx.work}")
    ctx.log(f"{where}; it moved nothing")


def _find_non_finite(tensors: dict[str, Tensor]) -> list[NonFinite]:
    return find_non_finite({name: t.detach().float().cpu().numpy() for name, t in tensors.items()})


def _draw_pictures(lesson: Lesson, config: Config, rng: np.random.Generator) -> list[Picture]:
    """Pictures of one step: the capture's, and the corpus's share where there is one."""
    from_corpus = rng.random(config.batch) < config.corpus_share
    return [
        pool[int(rng.integers(len(pool)))]
        for pool in (lesson.corpus if corpus and lesson.corpus else lesson.capture for corpus in from_corpus)
    ]


def _measure_held_out_loss(state: TrainingState, config: Config, exam: Batch) -> float:
    """The loss of the averaged weights on the exam, with the same noise every time."""
    generator = torch.Generator().manual_seed(EXAM_SEED)
    with torch.no_grad():
        return float(denoising_loss(state.average, exam, generator, config.t_range))


def judge(prior: InpaintingPrior, exam: Batch, config: Config) -> dict[str, float]:
    """Hole PSNR (dB) and LPIPS (VGG) on held-out crops where the truth is known, beside two classical fills."""
    generator = torch.Generator().manual_seed(EXAM_SEED)
    region = exam.hole * exam.teach
    taught = region.sum(dim=(1, 2, 3)) > 0
    if not taught.any():
        return {}
    image, hole, region = exam.image[taught], exam.hole[taught], region[taught]
    figures = {"crops": float(len(image))}
    filled = fill_each_way(prior, image, hole, generator, steps=config.sample_steps)
    for name, fill in filled.items():
        if (score := mean_psnr(hole_psnr(fill, image, region).tolist())) is not None:
            figures[f"hole_psnr_{name}"] = score
    taught_fills = [torch.where(region > 0, fill, image) for fill in filled.values()]
    figures |= {f"lpips_{n}": v for n, v in zip(filled, _measure_lpips(taught_fills, image), strict=True)}
    return figures


@torch.no_grad()
def _measure_lpips(fills: Sequence[Tensor], truth: Tensor) -> list[float]:
    """Mean over the crops, of each fill of them."""
    network = load("vgg", truth.device)
    rows = [
        [float(found) for found in network.differences(map(enlarge, (fill[i : i + 1] for fill in fills)), enlarge(one))]
        for i, one in enumerate(truth.split(1))
    ]
    return [float(mean) for mean in np.mean(rows, axis=0)]
