"""Which small prior learns most in a given time: `make bench-prior-variants CORPUS=FOLDER`.

    python -m benchmarks.prior.variants CORPUS [--minutes N] [--variants NAME ...] [--out FILE]

Every variant learns for as many CPU minutes (60 unless told otherwise) on the train split of the image-corpus artifact
CORPUS: same crops, holes, batch and course of the learning rate, one thread, bf16 where the processor has it. Then it
fills the same holes in the same crops of the test split, each at its own size; all are compared at 64 pixels.

Writes `benchmarks/results/prior_variants.json` after every variant, keeping those that were not asked for, and their
table beside it. Losses of variants mean different things and are not compared.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from benchmarks.prior.judge import Judge
from benchmarks.provenance import REPOSITORY, commit

from inpaint3d.contracts.models.artifacts import ImageCorpus, PriorSpec
from inpaint3d.contracts.store import load_artifact
from inpaint3d.diffusion.judging import fill_each_way
from inpaint3d.diffusion.prior import InpaintingPrior, bf16_pays
from inpaint3d.diffusion.training import Batch, begin, denoising_loss, step_generators, train_step
from inpaint3d.orchestrator.history import this_machine
from inpaint3d.stages.diffusion_training.config import SMALL, Config, MaskMix
from inpaint3d.stages.diffusion_training.pictures import corpus_pictures
from inpaint3d.stages.diffusion_training.teaching import Lesson, lesson_of

RESULTS = REPOSITORY / "benchmarks" / "results" / "prior_variants.json"
VARIANTS: dict[str, dict[str, Any]] = {
    "default": {},
    "the paper's conditioning": {
        "condition": "noise-fill", "known": "noised", "loss_region": "all", "prediction": "eps",
    },
    "known pixels noised": {"known": "noised"},
    "loss on all pixels": {"loss_region": "all"},
    "v": {"prediction": "v"},
    "colours alike": {"residual_colours": (1.0, 1.0, 1.0)},
    "no packing": {"packing": 1},
    "wide and shallow": {"width": 64, "multipliers": (2, 4), "blocks": (2, 2), "attention": (False, True)},
    "narrow and deep": {"width": 32, "blocks": (4, 4, 4)},
    "128 pixels": {"size": 128},
}  # fmt: skip
BATCH, RATE, WARM_UP, DECAY_SHARE, EMA = 16, 1e-3, 200, 0.4, 0.999
JUDGED_AT, EXAM_AT = 64, 128


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--minutes", type=float, default=60, help="CPU time of each variant")
    parser.add_argument("--variants", nargs="*", default=list(VARIANTS), choices=VARIANTS, metavar="NAME")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    corpus = load_artifact(options.corpus, "image-corpus@1", ImageCorpus)
    training, held_out = corpus_pictures(corpus), corpus_pictures(corpus, "test")
    config = Config(masks=MaskMix(rectangles=0.3, strokes=0.3, blobs=0.4, own=0.0), crop_share=(0.25, 1.0), exam=96)
    # Cut once, at the largest size, and reduced for those that are smaller.
    exam = lesson_of(config, SMALL.model_copy(update={"size": EXAM_AT}), training, held_out).exam
    judge = Judge(_resize(exam.image, JUDGED_AT))

    done: dict[str, Any] = json.loads(options.out.read_text())["variants"] if options.out.exists() else {}
    for name in options.variants:
        spec = PriorSpec.model_validate({**SMALL.model_dump(), **VARIANTS[name]})
        prior, steps = train_variant(spec, lesson_of(config, spec, training, held_out), options.minutes * 60)
        done[name] = {
            "changes": VARIANTS[name], **commit(), "cpu_minutes": options.minutes, "steps": steps,
            "parameters": sum(p.numel() for p in prior.parameters()), **judge_variant(prior, exam, judge),
        }  # fmt: skip
        report = {"machine": this_machine().model_dump(), "variants": done}
        options.out.write_text(json.dumps(report, indent=1) + "\n")
        print(name, json.dumps(done[name]), flush=True)
    options.out.with_suffix(".md").write_text(table(done))


def train_variant(spec: PriorSpec, lesson: Lesson, cpu_seconds: float) -> tuple[InpaintingPrior, int]:
    """The average of the weights after as many CPU seconds, and the steps they were enough for."""
    state, start = begin(spec, seed=0, bf16=bf16_pays()), time.process_time()
    while (left := 1 - (time.process_time() - start) / cpu_seconds) > 0:
        rng, generator = step_generators(0, state.step)
        pictures = [lesson.capture[i] for i in rng.integers(len(lesson.capture), size=BATCH)]
        batch = lesson.cropper.batch(pictures, rng)
        rate = RATE * min(1.0, (state.step + 1) / WARM_UP, left / DECAY_SHARE)
        train_step(
            state,
            lambda p, b=batch, g=generator: denoising_loss(p, b, g, (0.02, 1.0)),
            learning_rate=rate,
            ema=EMA,
        )
    return state.average, state.step


def judge_variant(prior: InpaintingPrior, exam: Batch, judge: Judge) -> dict[str, Any]:
    """Figures of its samples and expectation, and of the classical fills at the same size."""
    size = prior.spec.size
    shown = replace(exam, image=_resize(exam.image, size), hole=(_resize(exam.hole, size) > 0).float())
    filled = fill_each_way(prior, shown.image, shown.hole, torch.Generator().manual_seed(0))
    hole = (_resize(shown.hole, JUDGED_AT) > 0).float()
    return {name: judge.figures(_resize(pictures, JUDGED_AT), hole) for name, pictures in filled.items()}


def _resize(pictures: torch.Tensor, size: int) -> torch.Tensor:
    return pictures if pictures.shape[-1] == size else F.interpolate(pictures, size=(size, size), mode="area")


def table(done: dict[str, Any]) -> str:
    """The figures as Markdown; the classical fill is that of the first row's size."""
    lines = [
        "| variant | CPU minutes | steps | parameters | LPIPS, sample | KID-lite0, sample | PSNR, sample "
        "| PSNR, expectation | LPIPS, Telea |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in sorted(done.items(), key=lambda item: item[1]["sample"]["lpips"]):
        s = row["sample"]
        lines.append(
            f"| {name} | {row['cpu_minutes']:g} | {row['steps']} | {row['parameters'] / 1e6:.1f} M | {s['lpips']:.4f} "
            f"| {s['kid_lite0']:.4f} | {s['psnr']:.2f} | {row['expectation']['psnr']:.2f} "
            f"| {row['telea']['lpips']:.4f} |"
        )
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
