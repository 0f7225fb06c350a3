"""Train the general inpainting prior on a folder of photos, for as long as the machine can be spared.

    python benchmarks/prior/train.py PHOTOS OUT --hours 2

Resumes from OUT/checkpoint.safetensors. A hundred photos are held out by a hash of their name. OUT gets curve.csv,
held_out.csv, grids/STEP.png, and the prior itself: weights.safetensors (float16) with card.json, its model card.
"""

import argparse
import csv
import hashlib
import json
import signal
import time
from pathlib import Path

import cv2
import numpy as np
import torch

from inpaint3d.contracts.artifacts.prior import PriorSpec
from inpaint3d.diffusion import judging
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.masks import random_masks
from inpaint3d.diffusion.prior import bf16_pays
from inpaint3d.diffusion.training import (
    Batch,
    TrainingState,
    begin,
    denoising_loss,
    load_checkpoint,
    save_checkpoint,
    step_generators,
    train_step,
)

SPEC = PriorSpec(
    size=64,
    width=64,
    multipliers=(2, 4),
    blocks=(2, 2),
    attention=(False, True),
    packing=2,
    condition="mask-channel",
    known="clean",
    loss_region="hole",
    prediction="residual",
)
HELD_OUT = 100
EVERY_STEPS = 500
CHECKPOINT_S = 120
WARM_UP_STEPS = 200
DECAY_SHARE = 0.4
"""The last part of the time, in which the learning rate falls to zero."""


def main() -> None:
    options = arguments()
    torch.set_num_threads(options.threads)
    options.out.mkdir(parents=True, exist_ok=True)
    training, held_out = split(options.photos)
    photos = [cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB) for path in training]
    exam = held_out_batch(held_out, options.spec.size)
    state = begin(options.spec, seed=0, bf16=bf16_pays())
    checkpoint = options.out / "checkpoint.safetensors"
    clock = {"wall_s": 0.0, "cpu_s": 0.0}
    if checkpoint.exists():
        load_checkpoint(checkpoint, state)
        clock = json.loads((options.out / "clock.json").read_text())
    print(f"{len(photos)} photos, {len(held_out)} held out; from step {state.step}", flush=True)

    stop = []
    signal.signal(signal.SIGTERM, lambda *_: stop.append(True))
    wall, cpu, saved = time.monotonic() - clock["wall_s"], time.process_time() - clock["cpu_s"], time.monotonic()
    while not stop and time.monotonic() - wall < options.hours * 3600:
        rng, generator = step_generators(0, state.step)
        batch = crops(photos, options.batch, options.spec.size, rng)
        left = 1 - (time.monotonic() - wall) / (options.hours * 3600)
        rate = options.rate * min(1.0, (state.step + 1) / WARM_UP_STEPS, left / DECAY_SHARE)
        train_step(
            state,
            lambda prior, batch=batch, generator=generator: denoising_loss(prior, batch, generator, (0.02, 1.0)),
            learning_rate=rate,
            ema=0.9995,
        )
        clock = {"wall_s": time.monotonic() - wall, "cpu_s": time.process_time() - cpu}
        if state.step % 50 == 0:
            append(options.out / "curve.csv", {"step": state.step, "loss": np.nanmean(state.pending), **clock})
            state.pending.clear()
        if state.step % EVERY_STEPS == 0:
            judge(options.out, state, exam, clock, len(photos), options.batch)
        if time.monotonic() - saved > CHECKPOINT_S:
            keep(checkpoint, state, clock)
            saved = time.monotonic()
    keep(checkpoint, state, clock)
    judge(options.out, state, exam, clock, len(photos), options.batch)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("photos", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--hours", type=float, default=2, help="wall time, all runs together")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=1e-3, help="learning rate after warm-up")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--spec", type=variant, default=SPEC, help="JSON of the settings that differ from the default")
    return parser.parse_args()


def variant(text: str) -> PriorSpec:
    return PriorSpec.model_validate({**SPEC.model_dump(), **json.loads(text)})


def split(folder: Path) -> tuple[list[Path], list[Path]]:
    """Training photos and the hundred whose names have the smallest hashes."""
    paths = sorted(p for p in folder.iterdir() if p.suffix.lower() in {".jpg", ".jpeg", ".png"})
    by_hash = sorted(paths, key=lambda p: hashlib.sha256(p.name.encode()).hexdigest())
    return sorted(by_hash[HELD_OUT:]), sorted(by_hash[:HELD_OUT])


def crops(photos: list[np.ndarray], count: int, size: int, rng: np.random.Generator) -> Batch:
    """Random square crops, from the prior's size to the whole short side, mirrored half the time, with random holes."""
    pictures = [crop(photos[rng.integers(len(photos))], size, rng) for _ in range(count)]
    image = torch.from_numpy(np.stack(pictures)).permute(0, 3, 1, 2).float() / 127.5 - 1
    hole = torch.from_numpy(random_masks(count, size, rng)).float()[:, None]
    return Batch(image=image, hole=hole, teach=torch.ones_like(hole))


def crop(photo: np.ndarray, size: int, rng: np.random.Generator) -> np.ndarray:
    short = min(photo.shape[:2])
    side = int(rng.integers(min(size, short), short + 1))
    y, x = (int(rng.integers(extent - side + 1)) for extent in photo.shape[:2])
    picture = cv2.resize(photo[y : y + side, x : x + side], (size, size), interpolation=cv2.INTER_AREA)
    return picture[:, ::-1] if rng.random() < 0.5 else picture


def held_out_batch(paths: list[Path], size: int) -> Batch:
    photos = [cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB) for path in paths]
    rng = np.random.default_rng(2**32)
    batches = [crops([photo], 1, size, rng) for photo in photos]
    return Batch(*(torch.cat([getattr(b, name) for b in batches]) for name in ("image", "hole", "teach")))


def judge(out: Path, state: TrainingState, exam: Batch, clock: dict[str, float], photos: int, batch: int) -> None:
    """Figures and a grid on the held-out photos, and the weights as they now are."""
    generator = torch.Generator().manual_seed(1)
    figures, samples = judging.compare_fills(state.average, exam.image, exam.hole, generator)
    with torch.no_grad():
        figures["loss"] = float(denoising_loss(state.average, exam, torch.Generator().manual_seed(2), (0.02, 1.0)))
    append(out / "held_out.csv", {"step": state.step, **figures, **clock})
    shown = [slice(0, 8), slice(8, 16)]
    expected = [judging.mean_estimate(state.average, exam.image[s], exam.hole[s], generator) for s in shown]
    rows = [judging.grid(exam.image[s], exam.hole[s], samples[s], e) for s, e in zip(shown, expected, strict=True)]
    (out / "grids").mkdir(exist_ok=True)
    grid = np.concatenate(rows, axis=1)
    cv2.imwrite(str(out / "grids" / f"{state.step:06d}.png"), cv2.cvtColor(grid, cv2.COLOR_RGB2BGR))
    save_prior(out / "weights.safetensors", state.average, half=True)
    card = {
        "spec": state.prior.spec.model_dump(mode="json"),
        "steps": state.step,
        "batch": batch,
        "hours": round(clock["wall_s"] / 3600, 2),
        "cpu_hours": round(clock["cpu_s"] / 3600, 2),
        "parameters": sum(p.numel() for p in state.average.parameters()),
        "held_out": {name: round(value, 2) for name, value in figures.items()},
        "trained_on": f"{photos} photos, short side 256 px: BSDS500, COCO128 and an ImageNet sample",
        "licences": "the photos belong to their authors and were used for research; none is redistributed",
    }
    (out / "card.json").write_text(json.dumps(card, indent=2) + "\n")
    print(json.dumps({"step": state.step, **{k: round(v, 2) for k, v in figures.items()}, **clock}), flush=True)


def keep(checkpoint: Path, state: TrainingState, clock: dict[str, float]) -> None:
    save_checkpoint(checkpoint, state)
    checkpoint.with_name("clock.json").write_text(json.dumps(clock))


def append(path: Path, row: dict[str, object]) -> None:
    fresh = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(row))
        if fresh:
            writer.writeheader()
        writer.writerow(row)


if __name__ == "__main__":
    main()
