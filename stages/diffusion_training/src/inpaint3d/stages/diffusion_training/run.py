"""Train the inpainting prior on the capture's own known pixels, from scratch or from a pretrained prior."""

import csv
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from inpaint3d.contracts.artifacts import DiffusionPrior, ImageCorpus, MaskSet, PosedCapture, PriorSpec
from inpaint3d.contracts.context import Context, Inputs, Outputs
from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.io import load_prior, save_prior
from inpaint3d.diffusion.judging import compare_fills
from inpaint3d.diffusion.prior import InpaintingPrior, bf16_pays
from inpaint3d.diffusion.runtimes import export_onnx, load_onnx, seconds_per_query
from inpaint3d.diffusion.training import (
    Batch,
    TrainingState,
    begin,
    denoising_loss,
    load_checkpoint,
    save_checkpoint,
    step_generators,
    train_step,
    warmed_up,
)
from inpaint3d.stages.diffusion_training.ahead import MadeAhead
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.grids import held_out_grid, own_holes_grid
from inpaint3d.stages.diffusion_training.pictures import (
    Cropper,
    KnownPicture,
    Picture,
    StoredPicture,
    corpus_pictures,
    known_pictures,
    mask_shapes,
)

CHECKPOINT_S = 20.0
AHEAD = 3
"""Steps whose pictures are decoded while others are learnt from."""
EXAM_SEED = 2**31 - 1
ONNX = "network.onnx"


@dataclass(frozen=True, eq=False)
class Lesson:
    """What is taught, and the exam afterwards."""

    capture: list[KnownPicture]
    corpus: list[StoredPicture]
    cropper: Cropper
    exam: Batch


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    ctx.progress(0, config.steps, "reading the known pixels")
    # One thread, whatever is offered: with two, convolutions sum in another order and the bytes would depend on them.
    # It leaves the other core to the stages that run beside this one.
    torch.set_num_threads(1)
    posed, masks = inputs.one("posed-capture", PosedCapture), inputs.one("mask-set", MaskSet)
    corpus = inputs.optional("image-corpus", ImageCorpus)
    pretrained = inputs.optional("pretrained-prior", DiffusionPrior)
    spec = pretrained.metadata.spec if pretrained else config.prior

    training, held_out = known_pictures(posed, masks)
    lesson = _lesson(config, spec, training, held_out, corpus_pictures(corpus))
    start = _load(pretrained) if pretrained else None
    state = _begin(config, spec, start, ctx)
    before = _judge(state.average, lesson.exam, config) if start is not None else {}
    _train(state, config, lesson, ctx, fine_tuning=start is not None)
    after = _judge(state.average, lesson.exam, config)

    folder = outputs.folder("diffusion-prior")
    save_prior(folder / "weights.safetensors", state.average)
    runtime = _runtime(config, folder, spec)
    _write_curve(folder / "training_curve.csv", state)
    generator = torch.Generator().manual_seed(EXAM_SEED)
    held_out_grid(folder / "samples/held_out.png", state.average, lesson.exam, config.sample_steps, generator)
    own_holes_grid(folder / "samples/own_holes.png", state.average, training, config.sample_steps, generator)
    outputs.write(
        "diffusion-prior",
        DiffusionPrior(
            spec=spec,
            **runtime,
            samples=("samples/held_out.png", "samples/own_holes.png"),
            steps=state.step,
            seed=ctx.seed,
            trained_on=_described(training, lesson.corpus),
            start=pretrained.digest if pretrained else "scratch",
            held_out=after | {f"start_{name}": value for name, value in before.items()},
            non_finite=dict(ctx.non_finite),
        ),
    )


def _lesson(
    config: Config,
    spec: PriorSpec,
    training: list[KnownPicture],
    held_out: list[KnownPicture],
    corpus: list[StoredPicture],
) -> Lesson:
    shapes = mask_shapes(training)
    if not shapes and config.masks.own == 1:
        raise ConfigurationError("masks.own is 1 but the capture's masks have no usable shape; set another mix")
    cropper = Cropper(spec.size, config.crop_share, config.masks, shapes, config.whole_share, config.enlarged)
    rng = np.random.default_rng(EXAM_SEED)
    exam = cropper.batch([held_out[i % len(held_out)] for i in range(config.exam)], rng)
    return Lesson(training, corpus, cropper, exam)


def _load(pretrained: Artifact[DiffusionPrior]) -> InpaintingPrior:
    try:
        return load_prior(pretrained.path(pretrained.metadata.weights), pretrained.metadata.spec)
    except ValueError as error:
        raise BadInputError(f"pretrained prior {pretrained.digest}: {error}") from error


def _begin(config: Config, spec: PriorSpec, start: InpaintingPrior | None, ctx: Context) -> TrainingState:
    bf16 = config.precision == "bf16" or (config.precision == "auto" and bf16_pays(ctx.device))
    state = begin(spec, ctx.seed, start, bf16=bf16, channels_last=config.channels_last)
    if config.compiled:
        state.prior.network.compile()
    if (checkpoint := ctx.work / "checkpoint.safetensors").exists():
        load_checkpoint(checkpoint, state)
        ctx.log(f"going on from step {state.step}")
    return state


def _train(state: TrainingState, config: Config, lesson: Lesson, ctx: Context, *, fine_tuning: bool) -> None:
    """The loop: crops with holes, one step, a row of the curve now and then, a checkpoint at least every minute."""
    peak = config.fine_tuning_rate if fine_tuning else config.learning_rate
    every = max(1, config.steps // config.curve_rows)
    saved = ctx.elapsed()[0]
    steps = MadeAhead(
        lambda step: _parts(lesson, config, ctx.seed, step), range(state.step, config.steps), threads=1, ahead=AHEAD
    )
    for losses in steps:
        rate = warmed_up(peak, state.step, config.steps, config.warm_up)
        loss = train_step(state, *losses, learning_rate=rate, ema=config.ema)
        if not np.isfinite(loss):
            ctx.non_finite["training_loss"] = ctx.non_finite.get("training_loss", 0) + 1
        if state.step % every == 0 or state.step == config.steps:
            state.close_row(_held_out_loss(state, config, lesson.exam))
            step, mean, held_out = state.curve[-1]
            ctx.record(
                "training_curve", step=step, loss=mean, held_out_loss=held_out, waited_s=round(steps.waited_s, 3)
            )
        if ctx.stopping or ctx.elapsed()[0] - saved > CHECKPOINT_S:
            save_checkpoint(ctx.work / "checkpoint.safetensors", state)
            saved = ctx.elapsed()[0]
        ctx.progress(state.step, config.steps, "training the prior", loss=loss)


def _parts(lesson: Lesson, config: Config, seed: int, step: int) -> list[Callable[[InpaintingPrior], Tensor]]:
    """The losses of a step, one for each part of its batch; the pictures are decoded and cut when this is called."""
    losses: list[Callable[[InpaintingPrior], Tensor]] = []
    for part in range(config.parts):
        rng, generator = step_generators(seed, step, part)
        batch = lesson.cropper.batch(_drawn(lesson, config, rng), rng)
        losses.append(partial(denoising_loss, batch=batch, generator=generator, t_range=config.t_range))
    return losses


def _drawn(lesson: Lesson, config: Config, rng: np.random.Generator) -> list[Picture]:
    """Pictures of one step: the capture's, and the corpus's share where there is one."""
    from_corpus = rng.random(config.batch) < config.corpus_share
    return [
        pool[rng.integers(len(pool))]
        for pool in (lesson.corpus if corpus and lesson.corpus else lesson.capture for corpus in from_corpus)
    ]


def _held_out_loss(state: TrainingState, config: Config, exam: Batch) -> float:
    """The loss of the averaged weights on the exam, with the same noise every time."""
    generator = torch.Generator().manual_seed(EXAM_SEED)
    with torch.no_grad():
        return float(denoising_loss(state.average, exam, generator, config.t_range))


def _judge(prior: InpaintingPrior, exam: Batch, config: Config) -> dict[str, float]:
    """Hole PSNR (dB) on held-out crops where the truth is known, beside two classical fills."""
    generator = torch.Generator().manual_seed(EXAM_SEED)
    region = exam.hole * exam.teach
    taught = region.sum(dim=(1, 2, 3)) > 0
    if not taught.any():
        return {}
    figures, _ = compare_fills(
        prior, exam.image[taught], exam.hole[taught], generator, region=region[taught], steps=config.sample_steps
    )
    return figures


def _runtime(config: Config, folder: Path, spec: PriorSpec) -> dict[str, Any]:
    """What the artifact says of its runtimes; the network is exported where another than torch may be the one."""
    if config.runtime == "torch":
        return {}
    path, prior = folder / ONNX, load_prior(folder / "weights.safetensors", spec)
    try:
        export_onnx(path, prior)
        exported = load_onnx(path, spec)
    except ValueError as error:
        raise ConfigurationError(f"runtime is {config.runtime!r}: {error}; or set runtime to 'torch'") from error
    if config.runtime == "onnxruntime":
        return {"onnx": path.name, "runtime": "onnxruntime"}
    seconds = {"torch": seconds_per_query(prior), "onnxruntime": seconds_per_query(exported)}
    return {"onnx": path.name, "runtime": min(seconds, key=seconds.__getitem__), "query_seconds": seconds}


def _described(training: list[KnownPicture], corpus: list[StoredPicture]) -> str:
    unknown = float(np.mean([p.unknown.mean() for p in training]))
    capture = (
        f"{len(training)} frames of the capture without the {unknown:.1%} of their pixels that are masked or missing"
    )
    return capture + (f", and {len(corpus)} pictures of an image corpus" if corpus else "")


def _write_curve(path: Path, state: TrainingState) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["step", "loss", "held_out_loss"])
        writer.writerows((step, f"{loss:.6g}", f"{held_out:.6g}") for step, loss, held_out in state.curve)
