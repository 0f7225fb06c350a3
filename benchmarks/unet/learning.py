"""Training on pictures: how long it waits for them, and what is learnt in a given time."""

import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import torch
from benchmarks.unet.contenders import BATCH, Figures, Peer, contenders, equal_peer
from torch import nn

from inpaint3d.contracts.models.artifacts import ImageCorpus, PriorSpec
from inpaint3d.contracts.store import load_artifact
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.training import Batch, TrainingState, begin, denoising_loss, step_generators, train_step
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.ahead import MadeAhead
from inpaint3d.stages.diffusion_training.config import Config, MaskMix
from inpaint3d.stages.diffusion_training.pictures import Cropper, StoredPicture, corpus_pictures
from inpaint3d.stages.diffusion_training.teaching import lesson_of

TURN_S, POINTS = 6.0, 6  # --learn: seconds of a turn, points of each curve
RATE = 3e-4  # at batches of this size 1e-3 is too much for all three: none leaves its start


def decoding(spec: PriorSpec, count: int = 6) -> Figures:
    """One thread decodes and cuts pictures of the size of RealEstate10k's while another trains."""
    noise = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        coarse = noise.integers(0, 256, (45, 80, 3), np.uint8)
        picture = cv2.resize(coarse, (1280, 720), interpolation=cv2.INTER_CUBIC)
        write_png(Path(folder) / "frame.png", picture)
        cv2.imwrite(f"{folder}/frame.jpg", picture)
        cropper = Cropper(spec.size, (0.45, 1.0), MaskMix(own=0, blobs=0.6), [])
        stored = [StoredPicture("frame", Path(folder) / "frame.jpg")] * BATCH
        state = begin(spec, seed=0)
        batches = MadeAhead(
            lambda step: cropper.batch(stored, np.random.default_rng(step)), range(count + 1), threads=1, ahead=3
        )
        start = 0.0
        for i, batch in enumerate(batches):
            if i == 1:  # the first has nothing to hide behind
                start, batches.waited_s = time.perf_counter(), 0.0
            generator = torch.Generator().manual_seed(i)
            train_step(state, lambda p, b=batch, g=generator: denoising_loss(p, b, g), learning_rate=1e-4)
        wall = time.perf_counter() - start
        return {
            "waited_share": round(batches.waited_s / wall, 4),
            "seconds_a_step": round(wall / count, 3),
            "batch_cpu_ms": round(1e3 * _batch_cpu_s(cropper, stored), 1),
        }


def _batch_cpu_s(cropper: Cropper, pictures: list[StoredPicture], repeats: int = 5) -> float:
    """CPU seconds of decoding and cutting a batch, the best of some: nothing else runs meanwhile."""
    times = []
    for i in range(repeats):
        start = time.process_time()
        cropper.batch(pictures, np.random.default_rng(i))
        times.append(time.process_time() - start)
    return min(times)


def learning(spec: PriorSpec, folder: Path, cpu_seconds: float) -> Figures:
    """Held-out loss of ours and of the peers after the same CPU seconds on the same pictures."""
    corpus = load_artifact(folder, "image-corpus@1", ImageCorpus)
    config = Config(masks=MaskMix(rectangles=0.3, strokes=0.3, blobs=0.4, own=0.0), exam=64)
    lesson = lesson_of(config, spec, corpus_pictures(corpus), corpus_pictures(corpus, "test"))
    states = {name: state_of(spec, network) for name, network in contenders(spec).items()}
    spent = dict.fromkeys(states, 0.0)
    curves: dict[str, list[list[float]]] = {name: [] for name in states}
    # In turns of a few seconds: what else the machine does slows all alike.
    while (name := min(spent, key=lambda n: spent[n])) and spent[name] < cpu_seconds:
        state, start = states[name], time.process_time()
        while time.process_time() - start < TURN_S:
            rng, generator = step_generators(0, state.step)
            drawn = [lesson.capture[i] for i in rng.integers(len(lesson.capture), size=BATCH)]
            batch = lesson.cropper.batch(drawn, rng)
            loss = lambda p, b=batch, g=generator: denoising_loss(p, b, g, (0.02, 1.0))  # noqa: E731
            train_step(state, loss, learning_rate=RATE * min(1.0, (state.step + 1) / 50), ema=0.99)
        spent[name] += time.process_time() - start
        if spent[name] >= min(cpu_seconds, (len(curves[name]) + 1) * cpu_seconds / POINTS):
            curves[name].append([round(spent[name], 1), round(exam_loss(state.average, lesson.exam), 4)])
            print(name, state.step, curves[name][-1], flush=True)
    return {"cpu_s": cpu_seconds} | {
        name: {"steps": state.step, "held_out_loss": curves[name][-1][1], "curve": curves[name]}
        for name, state in states.items()
    }


def state_of(spec: PriorSpec, network: nn.Module) -> TrainingState:
    twin = equal_peer(spec, network.packing) if isinstance(network, Peer) else InpaintingPrior(spec).network
    twin.load_state_dict(network.state_dict())
    prior, average = InpaintingPrior(spec, network=network), InpaintingPrior(spec, network=twin)
    average.requires_grad_(False).eval()
    return TrainingState(prior, average, torch.optim.Adam(prior.parameters(), betas=(0.9, 0.99), fused=True))


@torch.no_grad()
def exam_loss(prior: InpaintingPrior, exam: Batch) -> float:
    return float(denoising_loss(prior, exam, torch.Generator().manual_seed(1), (0.02, 1.0)))
