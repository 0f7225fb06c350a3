"""CPU seconds of a step, ours and the peers' in turns, and of one at the paper's configuration."""

import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import torch
from benchmarks.unet.contenders import BATCH, Figures, contenders, count
from torch import Tensor, nn

from inpaint3d.contracts.models.artifacts import PriorSpec
from inpaint3d.diffusion.prior import InpaintingPrior, input_channels
from inpaint3d.diffusion.runtimes import export_onnx, load_onnx
from inpaint3d.diffusion.training import Batch, begin, denoising_loss, train_step

PAPER_SIDE = 64
KINDS = ("fp32", "bf16", "channels_last", "onnxruntime", "compiled")


def in_turns(work: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """The least CPU seconds of each, after one time that is not counted."""
    seconds = {name: float("inf") for name in work}
    for turn in range(repeats + 1):
        for name, run in work.items():
            start = time.process_time()
            run()
            if turn:
                seconds[name] = min(seconds[name], time.process_time() - start)
    return seconds


def with_ratios(seconds: dict[str, float]) -> Figures:
    ratios = {f"over_{name}": round(seconds["ours"] / seconds[name], 3) for name in seconds if name != "ours"}
    return {"cpu_s": {name: round(value, 4) for name, value in seconds.items()}, **ratios}


def steps(spec: PriorSpec, kind: str, repeats: int) -> Figures:
    """{training, denoising} of a kind; onnxruntime does not train."""
    if kind == "onnxruntime":
        return {"denoising": onnx_steps(spec, 3 * repeats)}
    networks = contenders(spec)
    for network in networks.values():
        if kind == "channels_last":
            network.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        if kind == "compiled":
            network.compile()
    training = {name: training_step(network, spec, bf16=kind == "bf16") for name, network in networks.items()}
    denoising = {name: denoising_step(network, spec, bf16=kind == "bf16") for name, network in networks.items()}
    return {
        "training": with_ratios(in_turns(training, repeats)),
        "denoising": with_ratios(in_turns(denoising, 3 * repeats)),
    }


def training_step(network: nn.Module, spec: PriorSpec, *, bf16: bool) -> Callable[[], object]:
    optimiser = torch.optim.Adam(network.parameters(), fused=True)
    shown, log_snr = torch.randn(BATCH, input_channels(spec), spec.size, spec.size), torch.linspace(-6, 6, BATCH)

    def step() -> None:
        optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            output = network(shown, log_snr)
        output.float().square().mean().backward()
        optimiser.step()

    return step


def denoising_step(network: nn.Module, spec: PriorSpec, *, bf16: bool) -> Callable[[], object]:
    shown, log_snr = torch.randn(1, input_channels(spec), spec.size, spec.size), torch.zeros(1)

    def step() -> Tensor:
        with torch.no_grad(), torch.autocast("cpu", torch.bfloat16, enabled=bf16):
            return network(shown, log_snr)

    return step


def onnx_steps(spec: PriorSpec, repeats: int) -> Figures:
    with tempfile.TemporaryDirectory() as folder:
        work = {}
        for name, network in contenders(spec).items():
            path = Path(folder) / f"{name}.onnx"
            export_onnx(path, InpaintingPrior(spec, network=network))
            work[name] = denoising_step(load_onnx(path, spec).network, spec, bf16=False)
        return with_ratios(in_turns(work, repeats))


def paper() -> Figures:
    """The paper's configuration, one small picture forward and one training step."""
    state = begin(PriorSpec(), seed=0)
    shown, t = torch.randn(1, 3, PAPER_SIDE, PAPER_SIDE), torch.full((1,), 0.5)
    hole = torch.zeros(1, 1, PAPER_SIDE, PAPER_SIDE)
    hole[..., 16:48, 16:48] = 1
    start = time.process_time()
    with torch.no_grad():
        state.prior.predict_noise(shown, t, shown.clamp(-1, 1), hole, noise_fill=shown)
    forward = time.process_time() - start
    batch, generator = Batch(shown.clamp(-1, 1), hole, torch.ones_like(hole)), torch.Generator().manual_seed(0)
    start = time.process_time()
    loss = train_step(state, lambda p: denoising_loss(p, batch, generator), learning_rate=1e-4)
    return {
        "parameters": count(state.prior),
        "picture": PAPER_SIDE,
        "forward_cpu_s": round(forward, 2),
        "training_step_cpu_s": round(time.process_time() - start, 2),
        "loss": round(loss, 4),
        "peak_memory_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
    }
