"""Our side: `python -m benchmarks.radiance.ours FOLDER WHAT ...` is a process for each measurement, and prints JSON.

FOLDER is what `scene.run_until` filled. Every step is the stage's own `one_step`. One thread; CPU seconds are user +
system, and those of scoring are not counted.
"""

import argparse
import json
import math
import re
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from benchmarks.radiance import scene as scenes

from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.radiance import backends
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.optim import Adam
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import Pixels
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, one_step

REPOSITORY = Path(__file__).resolve().parents[2]
GROWTH = {"rays": (256, 512, 1024, 2048, 4096), "samples": (8, 16, 32, 64), "log2_table": (14, 16, 17, 18, 19, 20)}
# Until the curve is this flat, a point at each twentieth more of CPU time.
SPACING = 1.05


class Fit:
    """A field under way, as nerf-pretraining makes and fits it."""

    def __init__(
        self, scene: scenes.Scene, pixels: Pixels, config: Config, seed: int, backend: backends.Name | None = None
    ) -> None:
        spec = field_spec(
            config.architecture,
            scene.plan,
            views=len(scene.train),
            centre_depth=scene.centre_depth,
            points=scene.points,
        )
        self.config, self.known, self.cpu_s = config, Known(pixels, scene.sight_lines), 0.0
        self.field = RadianceField(spec, seed, backend)
        self.optimizer = Adam.of(self.field, config.optimizer, config.loss_weights)
        self.generator = torch.Generator().manual_seed(seed)

    def step(self) -> float:
        """One step; its CPU seconds."""
        start = time.process_time()
        one_step(self.field, self.known, self.optimizer, self.generator, self.config, {})
        spent = time.process_time() - start
        self.cpu_s += spent
        return spent


def configured(preset: str, repository: Path = REPOSITORY) -> Config:
    """nerf-pretraining's parameters under a preset of pipeline.yaml."""
    return Config.model_validate(Pipeline(repository / "pipeline.yaml").parameters("nerf-pretraining", preset))


def full_batches(config: Config, rays: int | None = None) -> Config:
    """The same with all the rays from the first step on."""
    rays = rays or config.rays
    return config.model_copy(update={"rays": rays, "first_rays": rays, "ramp_steps": 0})


def pixels_of(scene: scenes.Scene) -> Pixels:
    train = scene.train
    return Pixels.of([v.camera for v in train], [v.image() for v in train], [v.valid() for v in train])


def views(scene: scenes.Scene, options: argparse.Namespace) -> dict[str, Any]:
    """Write the views for the peer; what they are."""
    scenes.write_for_peer(scene, options.folder / "views.npz", options.side)
    camera = scene.test[0].camera
    return {
        "training_views": len(scene.train),
        "test_views": [view.name for view in scene.test],
        "size": [camera.width, camera.height],
        "effects_on": [effect.name for effect in scene.plan.effects if scene.plan.active(effect.name)],
    }


def rate(scene: scenes.Scene, options: argparse.Namespace) -> dict[str, Any]:
    """Rays per CPU second at a batch size, after a step that is not counted."""
    config = full_batches(configured(options.preset), options.rays)
    fit = Fit(scene, pixels_of(scene), config, options.seed, options.backend)
    for _ in range(options.warmup):
        fit.step()
    spent = [fit.step() for _ in range(options.steps)]
    return {
        "rays": config.rays,
        "steps": options.steps,
        "cpu_s_per_step": sum(spent) / len(spent),
        "rays_per_cpu_s": config.rays * len(spent) / sum(spent),
    }


def curve(scene: scenes.Scene, options: argparse.Namespace) -> dict[str, Any]:
    """Held-out PSNR over CPU seconds: lattice of pixels as it goes (`curve`), whole pictures at `marks`."""
    fit = Fit(scene, pixels_of(scene), configured(options.preset), options.seed)
    lattice, whole = (
        HeldOut.on_lattice(map(KnownPhoto.of, scene.test), side, "cpu") for side in (options.side, options.whole_side)
    )
    points: list[tuple[float, float]] = []
    marks: dict[str, float | None] = {}
    left = sorted(options.marks)
    limit = max([*left, 0.0]) if left else options.limit_s
    due = options.every_s
    while fit.cpu_s < limit and not (options.until_db and points and points[-1][1] >= options.until_db):
        fit.step()
        if fit.cpu_s >= due or fit.cpu_s >= limit:
            points.append((fit.cpu_s, lattice.psnr(fit.field, fit.config.block) or math.nan))
            due = max(fit.cpu_s + options.every_s, fit.cpu_s * SPACING)
        while left and fit.cpu_s >= left[0]:
            marks[f"{left.pop(0):g}"] = whole.psnr(fit.field, fit.config.block)
    best = np.maximum.accumulate([db for _, db in points])
    return {
        "steps": fit.optimizer.steps,
        "curve": points,
        "psnr": marks,
        "largest_drop_db": float((best - [db for _, db in points]).max()) if points else None,
    }


def growth(scene: scenes.Scene, options: argparse.Namespace) -> dict[str, Any]:
    """CPU seconds of a step against what sizes it, all else as in the default configuration."""
    pixels, base = pixels_of(scene), configured(options.preset)
    found: dict[str, Any] = {}
    for name, values in GROWTH.items():
        times = {}
        for value in values[:: options.stride]:
            architecture = base.architecture
            if name != "rays":
                architecture = architecture.model_copy(update={name: value})
            config = full_batches(
                base.model_copy(update={"architecture": architecture}), value if name == "rays" else None
            )
            fit = Fit(scene, pixels, config, options.seed)
            for _ in range(options.warmup):
                fit.step()
            times[value] = statistics.median(fit.step() for _ in range(options.steps))
        # A table of log2 k holds 2^k entries: time over entries, as the other two are over rays and samples.
        sizes = [math.log(2) * v if name == "log2_table" else math.log(v) for v in times]
        logs = [math.log(t) for t in times.values()]
        found[name] = {
            "cpu_s_per_step": {str(v): t for v, t in times.items()},
            "exponent": float(np.polyfit(sizes, logs, 1)[0]),
            "exponent_last": (logs[-1] - logs[-2]) / (sizes[-1] - sizes[-2]),
        }
    return found


def peak_bytes() -> int:
    """Largest resident set of this process. Not getrusage's, which counts the parent's before exec."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    return int(found[1]) * 1024 if found else 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("what", choices=("views", "rate", "curve", "growth"))
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rays", type=int, help="rate: rays a step; default: the preset's")
    parser.add_argument("--backend", choices=("native", "reference", "compiled"), help="rate: default: the fastest")
    parser.add_argument("--steps", type=int, default=20, help="rate, growth: steps that count")
    parser.add_argument("--warmup", type=int, default=3, help="rate, growth: steps before them")
    parser.add_argument("--marks", type=float, nargs="*", default=[], help="curve: CPU seconds of whole pictures")
    parser.add_argument("--limit-s", type=float, default=120, help="curve without marks: CPU seconds")
    parser.add_argument("--every-s", type=float, default=0.25, help="curve: CPU seconds between points, at least")
    parser.add_argument("--until-db", type=float, help="curve: stop at this PSNR")
    parser.add_argument("--side", type=int, default=60, help="curve: longest side of a picture's lattice, pixels")
    parser.add_argument("--whole-side", type=int, default=10**9, help="curve: the same at marks; default: every pixel")
    parser.add_argument("--stride", type=int, default=1, help="growth: take every so many sizes")
    options = parser.parse_args()
    torch.set_num_threads(1)
    measure = {"views": views, "rate": rate, "curve": curve, "growth": growth}[options.what]
    result = measure(scenes.load(options.folder), options)
    print(json.dumps({**result, "peak_memory_bytes": peak_bytes(), "torch": torch.__version__}))


if __name__ == "__main__":
    main()
