"""A general prior of an image corpus alone, on as many processes as torchrun starts (D12).

    torchrun --nproc-per-node 2 -m inpaint3d.stages.diffusion_training.pretrain CORPUS OUT [--config FILE]

CORPUS is an image-corpus artifact, FILE holds parameters of the stage as YAML. The `parts` of a step are shared out
over the processes, so that their number changes nothing of what is learnt but the order of sums. Stopped or killed, the
same command goes on from OUT/checkpoint.safetensors. OUT/prior becomes a diffusion-prior artifact, for
`inpaint3d run --prior OUT/prior`.
"""

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import Any

import torch
from pydantic import ValidationError

from inpaint3d.contracts.artifacts import DiffusionPrior, ImageCorpus
from inpaint3d.contracts.canonical import canonical_json
from inpaint3d.contracts.context import Context
from inpaint3d.contracts.documents import load_yaml
from inpaint3d.contracts.errors import BadInputError, ConfigurationError, Inpaint3dError, from_os_error
from inpaint3d.contracts.manifest import MANIFEST, Manifest, build_manifest, first_error, read_metadata
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.parallel import join_ranks, leave_ranks, own_parts, rank
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.grids import held_out_grid
from inpaint3d.stages.diffusion_training.pictures import corpus_pictures
from inpaint3d.stages.diffusion_training.run import runtime_of, write_curve
from inpaint3d.stages.diffusion_training.teaching import EXAM_SEED, begin_or_resume, judge, lesson_of, train


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("corpus", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", type=Path, help="parameters of diffusion-training, YAML")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)
    join_ranks()
    try:
        pretrain(options.corpus, options.out, _config(options.config), options.seed)
    except (Inpaint3dError, OSError) as error:
        failure = from_os_error(error) if isinstance(error, OSError) else error
        sys.stderr.write(f"pretrain: {failure.kind}: {failure}\n")
        sys.exit(failure.exit_code)
    finally:
        leave_ranks()


def pretrain(folder: Path, out: Path, config: Config, seed: int) -> None:
    """Train, and on the first rank write the artifact.

    Raises BadInputError for a folder that is no corpus to learn from, ConfigurationError for parts that the ranks
    cannot share.
    """
    try:
        own_parts(config.parts)
    except ValueError as error:
        raise ConfigurationError(f"parts: {error}") from error
    corpus = _corpus(folder)
    training, held_out = corpus_pictures(corpus), corpus_pictures(corpus, "test")
    if not training or not held_out:
        raise BadInputError(
            f"{folder} has {len(training)} pictures to learn from and {len(held_out)} held out; make a corpus with both"
        )
    work = out / f"rank-{rank()}"
    work.mkdir(parents=True, exist_ok=True)
    ctx = Context(seed=seed, device="cpu", threads=1, work=work, emit=_say)
    signal.signal(signal.SIGTERM, lambda *_: setattr(ctx, "stopping", True))
    lesson = lesson_of(config, config.prior, training, held_out)
    checkpoint = out / "checkpoint.safetensors"
    state = begin_or_resume(config, config.prior, None, ctx, checkpoint)
    train(state, config, lesson, ctx, checkpoint, fine_tuning=False)
    if rank() > 0:
        return
    prior = out / "prior"
    prior.mkdir(exist_ok=True)
    save_prior(prior / "weights.safetensors", state.average)
    write_curve(prior / "training_curve.csv", state)
    generator = torch.Generator().manual_seed(EXAM_SEED)
    held_out_grid(prior / "samples/held_out.png", state.average, lesson.exam, config.sample_steps, generator)
    metadata = DiffusionPrior(
        spec=config.prior,
        **runtime_of(config, prior, config.prior),
        samples=("samples/held_out.png",),
        steps=state.step,
        seed=seed,
        trained_on=f"{len(training)} pictures of an image corpus",
        held_out=judge(state.average, lesson.exam, config),
        non_finite=dict(ctx.non_finite),
    )
    manifest = build_manifest(prior, "diffusion-prior", metadata)
    (prior / MANIFEST).write_bytes(canonical_json(manifest.dumped()))


def _corpus(folder: Path) -> Artifact[ImageCorpus]:
    try:
        manifest = Manifest.model_validate_json((folder / MANIFEST).read_bytes())
    except (FileNotFoundError, ValidationError) as error:
        raise BadInputError(
            f"{folder} is no image-corpus artifact; make one with python -m inpaint3d.stages.diffusion_training.corpus"
        ) from error
    return Artifact(folder, manifest.digest, manifest, read_metadata(manifest, ImageCorpus))


def _config(path: Path | None) -> Config:
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
