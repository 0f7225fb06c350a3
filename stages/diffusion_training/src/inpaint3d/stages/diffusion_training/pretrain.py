"""A general prior of image corpora alone, on as many processes as torchrun starts (D12).

    torchrun --nproc-per-node 2 -m inpaint3d.stages.diffusion_training.pretrain CORPUS ... OUT [--config FILE]
        [--prior DIR] [--device cuda]

A CORPUS is an image-corpus artifact; of several, every picture is drawn as often as any other. FILE holds parameters of
the stage as YAML, DIR is a diffusion-prior artifact to go on from, with a fresh optimiser. On GPUs each process has one
of its own. The `parts` of a step are
shared out over the processes, so that their number changes nothing of what is learnt but the order of sums. Stopped or
killed, the same command goes on from OUT/checkpoint.safetensors. OUT/prior becomes a diffusion-prior artifact in half
precision, for `inpaint3d run --prior OUT/prior`. OUT/held_out.png shows pictures of the corpora, which may not be ours
to pass on: it is not part of the artifact.
"""

import argparse
import json
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.commands import exit_on_error
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import DiffusionPrior, ImageCorpus
from inpaint3d.contracts.models.canonical import canonical_json
from inpaint3d.contracts.models.documents import load_yaml
from inpaint3d.contracts.models.manifest import MANIFEST, build_manifest, first_error
from inpaint3d.contracts.store import load_artifact
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.parallel import join_ranks, leave_ranks, own_parts, rank
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.grids import held_out_grid
from inpaint3d.stages.diffusion_training.pictures import corpus_pictures
from inpaint3d.stages.diffusion_training.run import load_pretrained, runtime_of, write_curve
from inpaint3d.stages.diffusion_training.teaching import EXAM_SEED, begin_or_resume, judge, lesson_of, train


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("corpus", type=Path, nargs="+")
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", type=Path, help="parameters of diffusion-training, YAML")
    parser.add_argument("--prior", type=Path, help="diffusion-prior artifact to go on from")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    options = parser.parse_args()
    torch.set_num_threads(1)
    device = join_ranks(options.device)
    try:
        with exit_on_error("pretrain"):
            pretrain(options.corpus, options.out, _read_config(options.config), options.seed, options.prior, device)
    finally:
        leave_ranks()


def pretrain(
    folders: Sequence[Path], out: Path, config: Config, seed: int, start: Path | None = None, device: str = "cpu"
) -> None:
    """Train on a device, and on the first rank write the artifact.

    Raises ConfigurationError for folders that hold no corpus or prior and for parts that the ranks cannot share,
    BadInputError for corpora that have nothing to learn from.
    """
    try:
        own_parts(config.parts)
    except ValueError as error:
        raise ConfigurationError(f"parts: {error}") from error
    corpora = [load_artifact(folder, "image-corpus@1", ImageCorpus) for folder in folders]
    training = [picture for corpus in corpora for picture in corpus_pictures(corpus)]
    held_out = [picture for corpus in corpora for picture in corpus_pictures(corpus, "test")]
    if not training or not held_out:
        raise BadInputError(
            f"{', '.join(map(str, folders))}: {len(training)} pictures to learn from and {len(held_out)} held out; "
            "make a corpus with both"
        )
    work = out / f"rank-{rank()}"
    work.mkdir(parents=True, exist_ok=True)
    ctx = Context(seed=seed, device=device, threads=1, work=work, emit=_say)
    signal.signal(signal.SIGTERM, lambda *_: setattr(ctx, "stopping", True))
    pretrained = load_artifact(start, "diffusion-prior@1", DiffusionPrior) if start else None
    spec = pretrained.metadata.spec if pretrained else config.prior
    lesson = lesson_of(config, spec, training, held_out, device=device)
    checkpoint = out / "checkpoint.safetensors"
    weights = load_pretrained(pretrained) if pretrained else None
    state = begin_or_resume(config, spec, weights, ctx, checkpoint)
    train(state, config, lesson, ctx, checkpoint, fine_tuning=pretrained is not None)
    if rank() > 0:
        return
    prior = out / "prior"
    prior.mkdir(exist_ok=True)
    save_prior(prior / "weights.safetensors", state.average, half=True)
    write_curve(prior / "training_curve.csv", state)
    generator = torch.Generator().manual_seed(EXAM_SEED)
    held_out_grid(out / "held_out.png", state.average, lesson.exam, config.sample_steps, generator)
    metadata = DiffusionPrior(
        spec=spec,
        **runtime_of(config, prior, spec),
        steps=state.step,
        seed=seed,
        trained_on=f"{len(training)} pictures of "
        + ("an image corpus" if len(corpora) == 1 else f"{len(corpora)} image corpora"),
        start=pretrained.digest if pretrained else "scratch",
        held_out=judge(state.average, lesson.exam, config),
        non_finite=dict(ctx.non_finite),
    )
    manifest = build_manifest(prior, "diffusion-prior", metadata)
    (prior / MANIFEST).write_bytes(canonical_json(manifest.dump()))


def _read_config(path: Path | None) -> Config:
    try:
        return Config.model_validate(load_yaml(path)[0] if path else {})
    except ValidationError as error:
        raise ConfigurationError(f"{path}: {first_error(error)}") from error


def _say(event: str, **values: Any) -> None:
    if rank() == 0:
        sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
