"""A prior judged on its own, on photos that it was not trained on: `make bench-prior CORPUS=FOLDER [PRIOR=FOLDER]`.

    python -m benchmarks.prior CORPUS [--prior FOLDER ...] [--size N] [--count N] [--steps N] [--draws N]
        [--out FILE] [--grids FOLDER]

CORPUS is the image-corpus artifact that the prior was trained on, of which some photos were held out by a hash of their
names; --prior is a diffusion-prior artifact, the repository's own unless another is named. Each held-out photo's middle
square, at the largest prior's size unless another is given, is filled under three kinds of holes by

    ours             a DDIM sample of the prior in three steps, chosen among 2, 3, 4 and 8 on crops of two captures that
                     it was neither trained nor is judged on (more steps add grain, fewer blur)
    NAME             the same of each further prior, by its folder's name. A prior of another size than the pictures is
                     asked about them at its own, and its fill is resized
    mean             the mean colour of the known pixels
    telea            OpenCV's fast marching (Telea 2004)
    navier_stokes    OpenCV's Navier-Stokes (Bertalmio 2001)
    patch            OpenCV's shift map: whole patches from elsewhere in the picture (He and Sun 2012), in Lab

Written to --out (`prior.json` among the results, `prior_64.json` of 64 pixels, and the model card): of each,
LPIPS (VGG, mean over photos, lower is better),
KID over stand-in features (EfficientNet-Lite0, hence kid_lite0, of all pictures against all truths, lower is better),
PSNR in the hole (mean, dB). Holes and noise come from fixed seeds; every photo is filled with --draws holes of each
kind, and figures are means over the draws, with the standard deviation of KID between them: 100 pictures leave it to
chance in the third decimal, and the shift map is not the same from run to run. Grids (hole, then the fills in this
order, truth) show the photos, which are not the project's to publish: they go to a folder that is not committed.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
from benchmarks.pages import fill_between
from benchmarks.prior.fills import HOLES, SEED, choose_fills
from benchmarks.prior.judge import Judge, find_best, over_draws
from benchmarks.provenance import REPOSITORY, commit
from torch import Tensor

from inpaint3d.contracts.models.artifacts import DiffusionPrior, ImageCorpus
from inpaint3d.contracts.store import Artifact, load_artifact
from inpaint3d.diffusion.io import load_prior
from inpaint3d.diffusion.judging import to_bytes
from inpaint3d.orchestrator.history import this_machine
from inpaint3d.scene.image_io import write_png

GENERAL = REPOSITORY / "priors" / "general"
RESULTS = {
    "prior": REPOSITORY / "benchmarks" / "results" / "prior.json",
    "prior-64": REPOSITORY / "benchmarks" / "results" / "prior_64.json",
}
"""Tables of the model card: of pictures at the prior's own size, and at 64 pixels."""
CARD = REPOSITORY / "priors" / "README.md"
GRID_ROWS = 12


def main() -> None:
    options = arguments()
    torch.set_num_threads(options.threads)
    artifacts = name_priors(options.prior)
    priors = {name: load_prior(a.path(a.metadata.weights), a.metadata.spec) for name, a in artifacts.items()}
    size = options.size or max(prior.size for prior in priors.values())
    corpus = load_artifact(options.corpus, "image-corpus@1", ImageCorpus)
    held_out = [corpus.path(p.path) for p in corpus.metadata.pictures if p.split == "test"][: options.count]
    truth = torch.stack([middle_square(path, size) for path in held_out])
    judge = Judge(truth)
    masks: dict[str, Any] = {}
    for kind, draw in HOLES.items():
        found: dict[str, list[dict[str, float]]] = {}
        for seed in range(SEED, SEED + options.draws):
            rng = np.random.default_rng(seed)
            cv2.setRNGSeed(seed)  # shift maps are found by chance
            hole = torch.from_numpy(np.stack([draw(size, rng) for _ in truth])).float()[:, None]
            filled = {name: fill(truth, hole) for name, fill in choose_fills(priors, options.steps).items()}
            for name, figures in judge.figures(filled, hole).items():
                found.setdefault(name, []).append(figures)
            if seed == SEED:
                write_png(options.grids / f"{kind}.png", grid(truth, hole, filled))
        masks[kind] = {name: over_draws(figures) for name, figures in found.items()}
        print(kind, json.dumps(masks[kind], indent=1), flush=True)
    report = {
        "machine": this_machine().model_dump(),
        **commit(),
        "size": size,
        "priors": {
            name: {
                "digest": artifacts[name].digest,
                "size": prior.size,
                "parameters": sum(p.numel() for p in prior.parameters()),
            }
            for name, prior in priors.items()
        },
        "photos": len(held_out),
        "draws": options.draws,
        "sampler": f"ddim, {options.steps} steps",
        "lpips_network": "vgg",
        "masks": masks,
        "ours_is_best_at": {kind: find_best(rows) for kind, rows in masks.items()},
    }
    options.out.parent.mkdir(parents=True, exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n")
    if options.out.resolve() in RESULTS.values():
        fill_card()


def fill_card() -> None:
    """Write the tables of all sizes into the model card."""
    for mark, path in RESULTS.items():
        if path.is_file():
            CARD.write_text(fill_between(CARD.read_text(), mark, f"\n{table(json.loads(path.read_text()))}\n"))


def table(report: dict[str, Any]) -> str:
    """What the model card says of these figures."""
    lines = [
        f"{report['photos']} held-out photos at {report['size']} pixels, {report['draws']} draws of holes; "
        f"{', '.join(report['priors'])}: {report['sampler']}.",
        "LPIPS (VGG) and KID-lite0 (EfficientNet-Lite0's features, not Inception's, hence not KID): lower is better;",
        "PSNR in the hole, dB. ±: between the draws.",
    ]
    for kind, rows in report["masks"].items():
        lines += ["", f"| {kind} | LPIPS | KID-lite0 | PSNR |", "|---|---|---|---|"]
        lines += [
            f"| {n} | {r['lpips']:.4f} | {r['kid_lite0']:.4f} ± {r['kid_lite0_spread']:.4f} | {r['psnr']:.2f} |"
            for n, r in rows.items()
        ]
    return "\n".join(lines)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("corpus", type=Path)
    parser.add_argument("--prior", type=Path, nargs="+", default=[GENERAL])
    parser.add_argument("--size", type=int, help="side of the pictures, pixels; default: that of the largest prior")
    parser.add_argument("--count", type=int, default=100, help="judge on the first so many held-out photos alone")
    parser.add_argument("--steps", type=int, default=3, help="DDIM steps of a sample")
    parser.add_argument("--draws", type=int, default=4, help="holes of each kind for a photo")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=RESULTS["prior"])
    parser.add_argument("--grids", type=Path, default=REPOSITORY / "runs" / "bench-prior")
    options = parser.parse_args()
    if options.count < 2:
        parser.error(f"--count {options.count}: KID needs at least 2 photos")
    if (options.count < 100 or options.draws < 2) and options.out.resolve() in RESULTS.values():
        parser.error("figures of fewer photos or of one draw are no results; give another file with --out")
    return options


def middle_square(path: Path, size: int) -> Tensor:
    """The largest square in the middle of a photo at the prior's size, [3, size, size] in [-1, 1]."""
    photo = cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)
    side = min(photo.shape[:2])
    y, x = ((extent - side) // 2 for extent in photo.shape[:2])
    square = cv2.resize(photo[y : y + side, x : x + side], (size, size), interpolation=cv2.INTER_AREA)
    return torch.from_numpy(square).permute(2, 0, 1).float() / 127.5 - 1


def name_priors(folders: Sequence[Path]) -> dict[str, Artifact[DiffusionPrior]]:
    """The first is ours, the others have their folders' names."""
    names = ["ours", *(folder.resolve().name for folder in folders[1:])]
    if len(set(names)) < len(names):
        sys.exit(f"priors are called {', '.join(names)}; give folders of different names")
    return {n: load_artifact(f, "diffusion-prior@1", DiffusionPrior) for n, f in zip(names, folders, strict=True)}


def grid(truth: Tensor, hole: Tensor, filled: dict[str, Tensor]) -> np.ndarray:
    columns = [torch.where(hole > 0, 0.0, truth), *filled.values(), truth]
    rows = [
        np.concatenate([np.pad(to_bytes(p[i]), ((1, 1), (1, 1), (0, 0))) for p in columns], axis=1)
        for i in range(min(GRID_ROWS, len(truth)))
    ]
    return np.concatenate(rows, axis=0)


if __name__ == "__main__":
    main()
