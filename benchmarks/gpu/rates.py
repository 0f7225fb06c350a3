"""Part 2: how fast the device is at what this project does, beside what it is capable of."""

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any, get_args

import torch
from benchmarks.gpu.correctness import COMPILING_S
from benchmarks.gpu.results import Results
from benchmarks.gpu.room import Fit, preset, room_fit, scene_fit, wait_for
from benchmarks.gpu.training import config_of, noise_batch

from inpaint3d.diffusion.samplers import inpaint
from inpaint3d.diffusion.training import TrainingState, begin, denoising_loss, train_step
from inpaint3d.radiance import backends
from inpaint3d.stages.nerf_pretraining.config import Config

QUALITY_S = (1, 2, 5, 10, 20)
"""Seconds of fitting after which a scene is looked at."""


def measure(options: argparse.Namespace, results: Results) -> None:
    device, tiny = options.device, options.tiny
    if device == "cpu":
        torch.set_num_threads(1)
    results.attempt("machine's own", lambda: measure_machine(device, tiny))
    results.attempt("prior, eager", lambda: rate_prior(device, tiny, compiled=False))
    results.attempt(
        "prior, eager, channels first", lambda: rate_prior(device, tiny, compiled=False, channels_last=False)
    )
    results.attempt("prior, a sample", lambda: rate_sample(device, tiny))
    for backend in ("native", "reference") if device == "cpu" else ("triton", "reference"):
        name = f"field of the paper, {backend}"
        results.attempt(name, lambda b=backend: rate_field(device, tiny, b), needs_s=1.0)
    results.attempt(
        "quality in time",
        lambda: quality(options, 0.1 if tiny else min(results.left_s / 2, QUALITY_S[-1])),
        needs_s=1.0,
    )
    if device != "cpu":
        results.attempt("field of the paper, compiled", lambda: rate_field(device, tiny, "compiled"), needs_s=60.0)
        results.attempt("prior, compiled", lambda: rate_prior(device, tiny, compiled=True), needs_s=COMPILING_S)


def seconds_of(work: Callable[[], object], device: str, repeats: int) -> float:
    """Median wall seconds of some work, after one time that is not counted."""
    work()
    times = []
    for _ in range(repeats):
        start = wait_for(device)
        work()
        times.append(wait_for(device) - start)
    return statistics.median(times)


def measure_machine(device: str, tiny: bool) -> dict[str, Any]:
    """A large matrix product in bf16, and a large copy, both ways counted."""
    side, numbers = (256, 2**20) if tiny or device == "cpu" else (8192, 2**30)
    a, b = (torch.randn(side, side, device=device, dtype=torch.bfloat16) for _ in range(2))
    product = seconds_of(lambda: a @ b, device, 10)
    source = torch.randn(numbers, device=device)
    target = torch.empty_like(source)
    copy = seconds_of(lambda: target.copy_(source), device, 10)
    return {
        "bf16_tflops": float(f"{2 * side**3 / product / 1e12:.3g}"),
        "copy_gb_s": round(8 * numbers / copy / 1e9, 1),
    }


def rate_prior(device: str, tiny: bool, *, compiled: bool, channels_last: bool = True) -> dict[str, Any]:
    """Samples a second of a training step on pictures that are there already."""
    config = config_of(tiny)
    state = prepare_training(config, device, compiled=compiled, channels_last=channels_last)
    batch = noise_batch(config.prior, config.batch).to(device)
    generator = torch.Generator(device).manual_seed(0)

    def step() -> None:
        train_step(state, lambda prior: denoising_loss(prior, batch, generator), learning_rate=1e-4)

    start = wait_for(device)
    step()
    first = wait_for(device) - start
    seconds = seconds_of(step, device, 2 if device == "cpu" else 10)
    return {
        "samples_per_s": round(config.batch / seconds, 2),
        "batch": config.batch,
        "first_step_s": round(first, 2),
        "parameters": sum(p.numel() for p in state.prior.parameters()),
        "peak_memory_bytes": torch.cuda.max_memory_allocated() if device == "cuda" else None,
    }


def prepare_training(config: Any, device: str, *, compiled: bool, channels_last: bool = True) -> TrainingState:
    """As diffusion-training begins on a device."""
    there = device != "cpu"
    state = begin(config.prior, 0, bf16=there, channels_last=there and channels_last, device=device)
    if compiled:
        state.prior.network.compile()
    return state


def rate_sample(device: str, tiny: bool) -> dict[str, Any]:
    """Wall seconds of a sample of one picture, by as many steps as the prior is judged by."""
    config = config_of(tiny)
    prior = prepare_training(config, device, compiled=False).average
    batch, chance = noise_batch(config.prior, 1).to(device), torch.Generator().manual_seed(0)
    steps = config.sample_steps
    seconds = seconds_of(
        lambda: inpaint(prior, batch.image, batch.hole, steps=steps, generator=chance), device, 3
    )  # fmt: skip
    return {"seconds_per_sample": round(seconds, 4), "steps": steps}


def rate_field(device: str, tiny: bool, backend: str) -> dict[str, Any]:
    """Rays a second of whole steps of the fit, under the preset `paper`."""
    if backend not in get_args(backends.Name):
        raise ValueError(f"{backend} is no backend")
    config = preset("paper")
    if tiny or device == "cpu":
        smaller = config.architecture.model_copy(update={"log2_table": 12, "proposal_log2_table": 12})
        config = config.model_copy(update={"rays": 256, "first_rays": 256, "architecture": smaller})
    fit = room_fit(device, tiny=tiny or device == "cpu", config=config, backend=backend)  # pyright: ignore[reportArgumentType]
    seconds = seconds_of(fit.step, device, 2 if tiny else 10)
    return {
        "rays_per_s": round(config.rays / seconds),
        "rays": config.rays,
        "entries": sum(len(network.table) for network in fit.field.hash_networks),
        "peak_memory_bytes": torch.cuda.max_memory_allocated() if device == "cuda" else None,
    }


def quality(options: argparse.Namespace, limit_s: float) -> dict[str, Any]:
    """Held-out PSNR after seconds of fitting, scoring not counted, under the preset `standard` with larger steps."""
    fit = _fit_of(options)
    fit.step()
    spent, found, left = 0.0, {}, [s for s in QUALITY_S if s <= limit_s] or [limit_s]
    while left:
        start = wait_for(options.device)
        for _ in range(5):
            fit.step()
        spent += wait_for(options.device) - start
        while left and spent >= left[0]:
            found[f"{left.pop(0):g}"] = round(fit.psnr(), 2)
    return {
        "scene": "made-up room" if options.scene is None else options.scene.name,
        "psnr_db_after_s": found,
        "steps": fit.optimizer.steps,
        "rays_per_s": round(fit.optimizer.steps * fit.config.rays / spent),
        "backend": backends.name_of(fit.field.backend),
        "at": time.strftime("%Y-%m-%d"),
    }


def _fit_of(options: argparse.Namespace) -> Fit:
    if options.tiny:
        return room_fit(options.device, tiny=True)
    config: Config = preset("standard")
    if options.device != "cpu":
        config = config.model_copy(update={"rays": 8192, "first_rays": 8192, "ramp_steps": 0})
    return (
        scene_fit(options.scene, options.device, config)
        if options.scene
        else room_fit(options.device, tiny=False, config=config)
    )
