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
from pathlib import Path

import torch
from benchmarks.pages import fill_between
from benchmarks.provenance import REPOSITORY, commit
from benchmarks.unet.contenders import BATCH, Figures, contenders, count
from benchmarks.unet.learning import decoding, learning
from benchmarks.unet.steps import KINDS, paper, steps
from benchmarks.unet.table import table

from inpaint3d.orchestrator.history import this_machine
from inpaint3d.stages.diffusion_training.config import SMALL

RESULTS = REPOSITORY / "benchmarks" / "results" / "unet.json"
README = REPOSITORY / "stages" / "diffusion_training" / "README.md"


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
