"""Train the inpainting prior on the capture's own known pixels, from scratch or from a pretrained prior."""

import csv
from pathlib import Path
from typing import Any

import numpy as np
import torch

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import DiffusionPrior, ImageCorpus, MaskSet, PosedCapture, PriorSpec
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.io import load_prior, save_prior
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.runtimes import export_onnx, load_onnx, seconds_per_query
from inpaint3d.diffusion.training import TrainingState
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.grids import held_out_grid, own_holes_grid
from inpaint3d.stages.diffusion_training.pictures import (
    KnownPicture,
    StoredPicture,
    corpus_pictures,
    known_pictures,
    mask_shapes,
)
from inpaint3d.stages.diffusion_training.teaching import EXAM_SEED, begin_or_resume, judge, lesson_of, train

ONNX = "network.onnx"


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    ctx.progress(0, config.steps, "reading the known pixels")
    # One thread, whatever is offered: with two, convolutions sum in another order and the bytes would depend on them.
    # It leaves the other core to the stages that run beside this one.
    torch.set_num_threads(1)
    posed, masks = inputs.one("posed-capture", PosedCapture), inputs.one("mask-set", MaskSet)
    corpus = inputs.optional("image-corpus", ImageCorpus)
    wired = inputs.optional("pretrained-prior", DiffusionPrior)
    pretrained = wired if config.start == "pretrained-prior" else None
    spec = pretrained.metadata.spec if pretrained else config.prior

    training, held_out = known_pictures(posed, masks)
    learnt_too = corpus_pictures(corpus)
    lesson = lesson_of(config, spec, training, held_out, learnt_too, mask_shapes(training), ctx.device)
    start = load_pretrained(pretrained) if pretrained else None
    checkpoint = ctx.work / "checkpoint.safetensors"
    state = begin_or_resume(config, spec, start, ctx, checkpoint)
    before = judge(state.average, lesson.exam, config) if start is not None else {}
    train(state, config, lesson, ctx, checkpoint, fine_tuning=start is not None)
    after = judge(state.average, lesson.exam, config) if state.step or start is None else before

    folder = outputs.folder("diffusion-prior")
    save_prior(folder / "weights.safetensors", state.average)
    runtime = runtime_of(config, folder, spec)
    write_curve(folder / "training_curve.csv", state)
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
            trained_on=_describe_pictures(training, learnt_too),
            start=pretrained.digest if pretrained else "scratch",
            held_out=after | {f"start_{name}": value for name, value in before.items()},
            non_finite=dict(ctx.non_finite),
        ),
    )


def load_pretrained(pretrained: Artifact[DiffusionPrior]) -> InpaintingPrior:
    """The weights to start from; BadInputError where they are not those of the artifact's spec."""
    try:
        return load_prior(pretrained.path(pretrained.metadata.weights), pretrained.metadata.spec)
    except ValueError as error:
        raise BadInputError(f"pretrained prior {pretrained.digest}: {error}") from error


def runtime_of(config: Config, folder: Path, spec: PriorSpec) -> dict[str, Any]:
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


def _describe_pictures(training: list[KnownPicture], corpus: list[StoredPicture]) -> str:
    unknown = float(np.mean([p.unknown.mean() for p in training]))
    capture = (
        f"{len(training)} frames of the capture without the {unknown:.1%} of their pixels that are masked or missing"
    )
    return capture + (f", and {len(corpus)} pictures of an image corpus" if corpus else "")


def write_curve(path: Path, state: TrainingState) -> None:
    """The learning curve as a table."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["step", "loss", "held_out_loss"])
        writer.writerows((step, f"{loss:.6g}", f"{held_out:.6g}") for step, loss, held_out in state.curve)
