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
import math
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from benchmarks.pages import fill_between
from benchmarks.provenance import REPOSITORY, commit
from torch import Tensor

from inpaint3d.contracts.models.artifacts import DiffusionPrior, ImageCorpus
from inpaint3d.contracts.store import Artifact, load_artifact
from inpaint3d.diffusion.io import load_prior
from inpaint3d.diffusion.judging import fill_batch_telea, hole_psnr, to_bytes
from inpaint3d.diffusion.masks import random_masks
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.samplers import inpaint
from inpaint3d.orchestrator.history import this_machine
from inpaint3d.perception import lpips
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.psnr import mean_psnr
from inpaint3d.stages.evaluation.features import lite0_features
from inpaint3d.stages.evaluation.frechet import kernel_distance

GENERAL = REPOSITORY / "priors" / "general"
RESULTS = {
    "prior": REPOSITORY / "benchmarks" / "results" / "prior.json",
    "prior-64": REPOSITORY / "benchmarks" / "results" / "prior_64.json",
}
"""Tables of the model card: of pictures at the prior's own size, and at 64 pixels."""
CARD = REPOSITORY / "priors" / "README.md"
SEED = 20
BATCH = 10
GRID_ROWS = 12

Fill = Callable[[Tensor, Tensor], Tensor]


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


def large(size: int, rng: np.random.Generator) -> np.ndarray:
    """One box over a third to two thirds of the picture."""
    height, width = (round(extent) for extent in np.sqrt(rng.uniform(1 / 3, 2 / 3)) * size * _aspect(rng))
    y, x = (int(rng.integers(size - extent + 1)) for extent in (height, width))
    mask = np.zeros((size, size), bool)
    mask[y : y + height, x : x + width] = True
    return mask


def _aspect(rng: np.random.Generator) -> np.ndarray:
    stretch = rng.uniform(0.85, 1.15)
    return np.array([stretch, 1 / stretch])


HOLES: Mapping[str, Callable[[int, np.random.Generator], np.ndarray]] = {
    "rectangles": lambda size, rng: random_masks(1, size, rng, {"rectangles": 1.0})[0],
    "strokes": lambda size, rng: random_masks(1, size, rng, {"strokes": 1.0})[0],
    "large": large,
}


def name_priors(folders: Sequence[Path]) -> dict[str, Artifact[DiffusionPrior]]:
    """The first is ours, the others have their folders' names."""
    names = ["ours", *(folder.resolve().name for folder in folders[1:])]
    if len(set(names)) < len(names):
        sys.exit(f"priors are called {', '.join(names)}; give folders of different names")
    return {n: load_artifact(f, "diffusion-prior@1", DiffusionPrior) for n, f in zip(names, folders, strict=True)}


def sample_by(prior: InpaintingPrior, steps: int) -> Fill:
    """Samples of a prior, at its own size."""

    def sample(image: Tensor, hole: Tensor) -> Tensor:
        generator = torch.Generator().manual_seed(SEED)
        parts = zip(image.split(BATCH), hole.split(BATCH), strict=True)
        return torch.cat([inpaint(prior, x, m, steps=steps, generator=generator) for x, m in parts])

    def resized(image: Tensor, hole: Tensor) -> Tensor:
        if image.shape[-1] == prior.size:
            return sample(image, hole)
        size = (prior.size, prior.size)
        # A cell that the hole touches is the hole's: it is an average over pixels that nobody may see.
        made = sample(F.interpolate(image, size, mode="area"), F.adaptive_max_pool2d(hole, size))
        return torch.where(hole > 0, F.interpolate(made, image.shape[-2:], mode="bilinear"), image)

    return resized


def choose_fills(priors: Mapping[str, InpaintingPrior], steps: int) -> dict[str, Fill]:
    return {
        **{name: sample_by(prior, steps) for name, prior in priors.items()},
        "mean": mean_fill,
        "telea": fill_batch_telea,
        "navier_stokes": each(lambda picture, hole: cv2.inpaint(picture, hole, 3, cv2.INPAINT_NS)),
        "patch": each(shift_map),
    }


def mean_fill(image: Tensor, hole: Tensor) -> Tensor:
    known = 1 - hole
    mean = (image * known).sum(dim=(2, 3), keepdim=True) / known.sum(dim=(2, 3), keepdim=True)
    return torch.where(hole > 0, mean, image)


def each(fill: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Fill:
    """A fill of 8-bit pictures [h, w, 3] under holes [h, w], 1 inside, as one of batches; known pixels are kept."""

    def whole(image: Tensor, hole: Tensor) -> Tensor:
        filled = [fill(to_bytes(p), h[0].byte().numpy()) for p, h in zip(image, hole, strict=True)]
        pictures = torch.from_numpy(np.stack(filled)).permute(0, 3, 1, 2).float() / 127.5 - 1
        return torch.where(hole > 0, pictures, image)

    return whole


def shift_map(picture: np.ndarray, hole: np.ndarray) -> np.ndarray:
    lab, filled = cv2.cvtColor(picture, cv2.COLOR_RGB2Lab), np.zeros_like(picture)
    # Its mask is that of the known pixels.
    cv2.xphoto.inpaint(lab, (1 - hole) * 255, filled, cv2.xphoto.INPAINT_SHIFTMAP)
    return cv2.cvtColor(filled, cv2.COLOR_Lab2RGB)


def over_draws(figures: list[dict[str, float]]) -> dict[str, float]:
    """Means over the draws, and KID's standard deviation between them (0 for one)."""
    means = {name: round(statistics.fmean(f[name] for f in figures), 5) for name in figures[0]}
    spread = statistics.stdev(f["kid_lite0"] for f in figures) if len(figures) > 1 else 0.0
    return means | {"kid_lite0_spread": round(spread, 5)}


class Judge:
    """The truths, and what they look like to the networks that judge."""

    def __init__(self, truth: Tensor) -> None:
        self.truth, self.pictures = truth, unit(truth)
        self.features = lite0_features(self.pictures)
        self.network = lpips.load("vgg")

    def figures(self, filled: Mapping[str, Tensor], hole: Tensor) -> dict[str, dict[str, float]]:
        """LPIPS, KID and PSNR of each fill of all photos; a truth's features are taken once for all fills."""
        pictures = {name: unit(fill) for name, fill in filled.items()}
        distances = np.mean(
            [
                self.network.distances([of_fill[i] for of_fill in pictures.values()], truth)
                for i, truth in enumerate(self.pictures)
            ],
            axis=0,
        )
        return {
            name: {
                "lpips": round(float(distance), 4),
                "kid_lite0": round(kernel_distance(lite0_features(pictures[name]), self.features), 5),
                "psnr": round(mean_psnr(hole_psnr(fill, self.truth, hole).tolist()) or math.nan, 2),
            }
            for (name, fill), distance in zip(filled.items(), distances, strict=True)
        }


def unit(pictures: Tensor) -> list[np.ndarray]:
    """[b, 3, h, w] in [-1, 1] as pictures [h, w, 3] in [0, 1]."""
    return list(((pictures + 1) / 2).permute(0, 2, 3, 1).numpy())


def find_best(rows: dict[str, dict[str, float]]) -> list[str]:
    """The figures at which no other fill is as good as ours."""
    others = [row for name, row in rows.items() if name != "ours"]
    lower = [name for name in ("lpips", "kid_lite0") if all(rows["ours"][name] < row[name] for row in others)]
    return lower + [name for name in ("psnr",) if all(rows["ours"][name] > row[name] for row in others)]


def grid(truth: Tensor, hole: Tensor, filled: dict[str, Tensor]) -> np.ndarray:
    columns = [torch.where(hole > 0, 0.0, truth), *filled.values(), truth]
    rows = [
        np.concatenate([np.pad(to_bytes(p[i]), ((1, 1), (1, 1), (0, 0))) for p in columns], axis=1)
        for i in range(min(GRID_ROWS, len(truth)))
    ]
    return np.concatenate(rows, axis=0)


if __name__ == "__main__":
    main()
