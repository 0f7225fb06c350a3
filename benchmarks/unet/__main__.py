"""What a step of the UNet costs against diffusers' UNet2DModel of equal size: `make bench-unet [CORPUS=FOLDER]`.

    python -m benchmarks.unet [--kinds KIND ...] [--paper] [--learn CPU_SECONDS --corpus FOLDER] [--out FILE]

Both are the network of the prior that the product trains by default: the same pictures in, the same out, parameters
equal to 4 %, attention at the coarsest level alone. The peer is met twice: over the pixels (`peer`), and behind the
same packing of pixels into channels that ours has (`peer_packed`). Figures are the least CPU seconds of a step, one
thread, ours and the peer's taken in turns; ratios are ours over the peer's, smaller is better for us.

- training: forward, backward and Adam on a batch of 8, by kind: fp32, bf16 (autocast), channels_last, and compiled,
  which takes many minutes and has to be asked for.
- denoising: forward of one picture, by the same kinds, and by onnxruntime.
- decoding: pictures of 720 x 1280 decoded and cut by one thread while ours trains: the share of time it waited for
  them.
- learning (`--learn`): held-out loss after as many CPU seconds of training on the image-corpus artifact --corpus, with
  the same crops, rates and loss, in turns.
- paper (`--paper`): parameters of the paper's configuration, and the seconds of one forward pass and one training step
  on one small picture: it needs 10 GiB.

Writes `benchmarks/results/unet.json`, keeping the parts that were not asked for, and the figures in the stage's README.
"""

import argparse
import json
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from benchmarks.pages import fill_between
from benchmarks.provenance import REPOSITORY, commit
from diffusers.models.unets.unet_2d import UNet2DModel
from torch import Tensor, nn

from inpaint3d.contracts.models.artifacts import ImageCorpus, PriorSpec
from inpaint3d.contracts.store import load_artifact
from inpaint3d.diffusion.prior import InpaintingPrior, input_channels
from inpaint3d.diffusion.runtimes import export_onnx, load_onnx
from inpaint3d.diffusion.training import Batch, TrainingState, begin, denoising_loss, step_generators, train_step
from inpaint3d.orchestrator.history import this_machine
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.ahead import MadeAhead
from inpaint3d.stages.diffusion_training.config import SMALL, Config, MaskMix
from inpaint3d.stages.diffusion_training.pictures import Cropper, StoredPicture, corpus_pictures
from inpaint3d.stages.diffusion_training.teaching import lesson_of

RESULTS = REPOSITORY / "benchmarks" / "results" / "unet.json"
README = REPOSITORY / "stages" / "diffusion_training" / "README.md"
BATCH = 8
PAPER_SIDE = 64
TURN_S, POINTS = 6.0, 6  # --learn: seconds of a turn, points of each curve
RATE = 3e-4  # at batches of this size 1e-3 is too much for all three: none leaves its start
KINDS = ("fp32", "bf16", "channels_last", "onnxruntime", "compiled")

Figures = dict[str, Any]


class Peer(nn.Module):
    """UNet2DModel in the place of an EfficientUNet: channels and log SNR in, channels out."""

    def __init__(self, spec: PriorSpec, width: int, packing: int) -> None:
        super().__init__()
        self.packing = packing
        down = [("Attn" if attention else "") + "DownBlock2D" for attention in spec.attention]
        self.network = UNet2DModel(
            sample_size=spec.size // packing,
            in_channels=input_channels(spec) * packing**2,
            out_channels=3 * packing**2,
            block_out_channels=tuple(width * m for m in spec.multipliers),
            layers_per_block=spec.blocks[0],
            down_block_types=tuple(down),
            up_block_types=tuple(reversed([name.replace("Down", "Up") for name in down])),
            norm_num_groups=8,
            attention_head_dim=32,
        )
        # Like ours, it starts as zero: as a prior, from the linear guess.
        nn.init.zeros_(self.network.conv_out.weight)
        nn.init.zeros_(self.network.conv_out.bias)

    def forward(self, x: Tensor, log_snr: Tensor) -> Tensor:
        x = nn.functional.pixel_unshuffle(x, self.packing)
        # Its embedding is made for timesteps 0 to 1000.
        return nn.functional.pixel_shuffle(self.network(x, (20 - log_snr) * 25).sample, self.packing)


def count(network: nn.Module) -> int:
    return sum(p.numel() for p in network.parameters())


def equal_peer(spec: PriorSpec, packing: int, seed: int = 0) -> Peer:
    """The width that comes nearest to the parameters of ours."""
    with torch.device("meta"):
        wanted = count(InpaintingPrior(spec))
        widths = range(16, 129, 8)
        nearest = min(widths, key=lambda width: abs(count(Peer(spec, width, packing)) - wanted))
    torch.manual_seed(seed)
    return Peer(spec, nearest, packing)


def contenders(spec: PriorSpec) -> dict[str, nn.Module]:
    return {
        "ours": InpaintingPrior(spec).network,
        "peer": equal_peer(spec, 1),
        "peer_packed": equal_peer(spec, spec.packing),
    }


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


def table(report: Figures) -> str:
    """What the stage's README says of these figures."""
    lines = [
        f"{report['machine']['processor']}, one thread, CPU seconds of a step (`make bench-unet`). The ratio is ours",
        "over diffusers' UNet2DModel of as many parameters behind the same packing of pixels:",
    ]
    lines += ["", "| step | how | ours | UNet2DModel | packed | ratio to packed |", "|---|---|---|---|---|---|"]
    for part in ("training", "denoising"):
        for kind, row in report.get(part, {}).items():
            s = row["cpu_s"]
            lines.append(
                f"| {part} | {kind} | {s['ours']:.3f} | {s['peer']:.3f} | {s['peer_packed']:.3f} "
                f"| {row['over_peer_packed']:.2f} |"
            )
    if "decoding" in report:
        share, cost = report["decoding"]["waited_share"], report["decoding"]["batch_cpu_ms"]
        lines += ["", f"Training waited for pictures of 720 x 1280 for {share:.1%} of its time."]
        lines += [f"Decoding and cutting {BATCH} of them takes {cost:.0f} CPU ms."]
    if "learning" in report:
        losses = ", ".join(
            f"{name} {report['learning'][key]['held_out_loss']:.3f}"
            for key, name in (("ours", "ours"), ("peer", "UNet2DModel"), ("peer_packed", "packed"))
        )
        lines += ["", f"Held-out loss after {report['learning']['cpu_s']:.0f} CPU seconds of training each: {losses}."]
    if "paper" in report:
        p = report["paper"]
        lines += [
            "",
            f"The paper's configuration (256 pixels, D7) has {p['parameters']:,} parameters. On one picture of "
            f"{p['picture']} pixels its forward pass takes {p['forward_cpu_s']:.1f} CPU seconds and a training step "
            f"{p['training_step_cpu_s']:.1f}, in {p['peak_memory_mib'] / 1024:.1f} GiB.",
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--kinds", nargs="*", default=KINDS[:-1], choices=KINDS, metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--paper", action="store_true")
    parser.add_argument("--learn", type=float, metavar="CPU_SECONDS")
    parser.add_argument("--corpus", type=Path, metavar="FOLDER")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    if options.learn and not options.corpus:
        parser.error("--learn needs --corpus FOLDER")
    torch.set_num_threads(1)
    report: Figures = json.loads(options.out.read_text()) if options.out.exists() else {}
    report |= {
        "machine": this_machine().model_dump(),
        **commit(),
        "batch": BATCH,
        "spec": SMALL.model_dump(mode="json"),
    }
    if options.paper:
        report["paper"] = paper()
    for kind in options.kinds:
        for part, figures in steps(SMALL, kind, options.repeats).items():
            report.setdefault(part, {})[kind] = figures
            print(part, kind, json.dumps(figures), flush=True)
        write(report, options.out)
    if options.kinds:
        report["parameters"] = {name: count(network) for name, network in contenders(SMALL).items()}
        report["decoding"] = decoding(SMALL)
    if options.learn:
        report["learning"] = learning(SMALL, options.corpus, options.learn)
    write(report, options.out)


def write(report: Figures, out: Path) -> None:
    out.parent.mkdir(exist_ok=True)
    out.write_text(json.dumps(report, indent=1) + "\n")
    if out == RESULTS:
        README.write_text(fill_between(README.read_text(), "unet", f"\n{table(report)}\n"))


if __name__ == "__main__":
    main()
