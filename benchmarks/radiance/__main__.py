"""Radiance fields on a CPU against a peer and against the machine: `make bench-radiance [FOX=FOLDER]`.

    python -m benchmarks.radiance [--fox FOLDER] [--quick] [--long] [--out FILE]

Writes `benchmarks/results/radiance.json`. Every ratio is of two figures taken in this run, one after the other, each in
a process of its own with one thread; larger is better for us. CPU seconds are user + system.

- rays_per_cpu_s_ratio_fast: training rays per CPU second over nerfacto's at its default batch of 4,096 rays, which ours
  takes too, in the field of the preset `draft`. _fast_own_batch: ours at that preset's own 512 rays. _default: the
  default field, at 4,096. _paper: the preset `paper` at its own 65,536.
- paper_over_eager, paper_over_compiled: rays per CPU second of the preset `paper` over the same model in eager torch
  (the reference backend) and in compiled torch, at 512 rays a step, where the dense step over all tables costs most.
- cpu_s_ratio_to_17_7_db, _18_4_db: nerfacto's CPU seconds to that held-out PSNR, at 512 rays a step, over ours (median
  of three seeds), on the same pixels of the same views. With `--long` also of the preset `paper` (one seed).
- rss_ratio, rss_ratio_paper: nerfacto's peak memory over ours (the largest of the fast and the default field's), at the
  batch sizes of the rates.
- fox_psnr: CPU seconds to dB over the whole held-out photos, mean of three seeds; needs `--fox`, a folder with
  transforms.json and images/. fox_largest_drop_db: below the best so far, over all seeds.
- mlp_fma_share, mlp_useful_share, encode_gather_share: see kernels.py.
- growth_exponents: of the time of a step over rays, samples and entries of a table.

Without `--fox` the peer is met on the demo capture.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.provenance import REPOSITORY, commit
from benchmarks.radiance import scene

from inpaint3d.orchestrator.history import this_machine

RESULTS = REPOSITORY / "benchmarks" / "results" / "radiance.json"
DEMO = REPOSITORY / "examples" / "demo" / "capture"
PEER = REPOSITORY / ".cache" / "radiance-peer" / "bin" / "python"
THRESHOLDS_DB = (17.7, 18.4)
SEEDS = (0, 1, 2)
MARKS_S = (10, 50, 120)
LONG_MARKS_S = (*MARKS_S, 200, 400, 800, 1200)
PAPER_LIMIT_S = 3000
# Pixels along a picture's longest side at which curves are scored, on both sides.
SIDE = 60

Figures = dict[str, Any]


class Bench:
    """The parts, on one scene."""

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self.options, self.folder, self.quick = options, folder, options.quick
        self.side = 12 if self.quick else SIDE

    def ours(self, what: str, *words: object) -> Figures:
        module = ["-m", "benchmarks.radiance.ours", str(self.folder), what, "--side", str(self.side)]
        return run_and_parse([sys.executable, *module, *map(str, words)])

    def peer(self, what: str, *words: object) -> Figures:
        script = REPOSITORY / "benchmarks" / "radiance" / "peer" / "nerfacto.py"
        return run_and_parse(
            [str(self.options.peer), str(script), str(self.folder / "views.npz"), what, *map(str, words)]
        )

    def rates(self) -> Figures:
        """Ours before and after the peer's: a machine that slows down meanwhile shows."""
        batch, steps = ("512", "1") if self.quick else ("4096", "10")
        fast = ["--preset", "draft", "--rays", batch, "--steps", steps]
        few = ["--rays", 512, "--steps", 1, "--warmup", 1]
        first = self.ours("rate", *fast)
        peer = self.peer("rate", "--rays", batch, "--steps", 1 if self.quick else 4)
        return {
            "peer": peer,
            "fast": [first, self.ours("rate", *fast)],
            "fast_own_batch": self.ours("rate", "--preset", "draft", "--steps", 1 if self.quick else 60),
            "default": self.ours("rate", "--rays", batch, "--steps", steps),
            "paper": self.ours("rate", "--preset", "paper", *(few if self.quick else ["--steps", 2, "--warmup", 1])),
            "paper_small": self.ours("rate", "--preset", "paper", *few),
            "paper_eager": self.ours("rate", "--preset", "paper", *few, "--backend", "reference"),
            # A step more before it counts: the first compiles.
            "paper_compiled": self.ours("rate", "--preset", "paper", *few, "--warmup", 2, "--backend", "compiled"),
        }

    def curves(self) -> Figures:
        limit = ["--limit-s", 3 if self.quick else 600]
        peer = self.peer(
            "curve", "--rays", 64 if self.quick else 512, "--until-db", THRESHOLDS_DB[-1],
            "--every-s", 2 if self.quick else 20, *limit,
        )  # fmt: skip
        ours = [
            self.ours("curve", "--seed", seed, "--until-db", THRESHOLDS_DB[-1], *limit)
            for seed in (SEEDS[:2] if self.quick else SEEDS)
        ]
        paper = None
        if self.options.long and not self.quick:
            words = ["--preset", "paper", "--until-db", THRESHOLDS_DB[-1], "--limit-s", PAPER_LIMIT_S, "--every-s", 30]
            paper = self.ours("curve", *words)
        return {"peer": peer, "ours": ours, "paper": paper}

    def fox(self) -> list[Figures]:
        marks = LONG_MARKS_S if self.options.long else MARKS_S
        words = ["--marks", *((1, 2) if self.quick else marks), "--preset", self.options.preset]
        if self.quick:
            words += ["--whole-side", 60]
        every = ["--every-s", 0.5 if self.quick else 1]
        return [self.ours("curve", "--seed", seed, *words, *every) for seed in (SEEDS[:2] if self.quick else SEEDS)]

    def growth(self) -> Figures:
        few = ["--steps", 2, "--warmup", 1, "--stride", 2] if self.quick else ["--steps", 15]
        return self.ours("growth", *few)

    def kernels(self) -> Figures:
        few = ["--rows", "4096", "--points", "16384", "--repeats", "3"] if self.quick else []
        return run_and_parse([sys.executable, "-m", "benchmarks.radiance.kernels", *few])


def run_and_parse(command: list[str]) -> Figures:
    """What a process of one thread printed as JSON on its last line."""
    print(" ".join(Path(word).name if "/" in word else word for word in command), file=sys.stderr, flush=True)
    single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    done = subprocess.run(
        command, cwd=REPOSITORY, check=True, stdout=subprocess.PIPE, text=True, env=os.environ | single
    )
    return json.loads(done.stdout.splitlines()[-1])


def seconds_to(db: float, curve: list[tuple[float, float]]) -> float | None:
    """CPU seconds at which a curve of (seconds, dB) first reaches a PSNR, between points in a straight line."""
    before: tuple[float, float] | None = None
    for cpu_s, reached in curve:
        if reached >= db:
            if before is None:
                return cpu_s
            return before[0] + (cpu_s - before[0]) * (db - before[1]) / (reached - before[1])
        before = (cpu_s, reached)
    return None


def over(above: float | None, below: float | None) -> float | None:
    return None if above is None or below is None else above / below


def headline(measured: Figures) -> Figures:
    """The figures that count, from those measured."""
    rates, curves, fox = measured["rates"], measured["curves"], measured["fox"]
    peer = rates["peer"]
    fast = statistics.mean(rate["rays_per_cpu_s"] for rate in rates["fast"])
    figures: Figures = {
        "rays_per_cpu_s_ratio_fast": fast / peer["rays_per_cpu_s"],
        **{
            f"rays_per_cpu_s_ratio_{name}": rates[name]["rays_per_cpu_s"] / peer["rays_per_cpu_s"]
            for name in ("fast_own_batch", "default", "paper")
        },
        **{
            f"paper_over_{name}": rates["paper_small"]["rays_per_cpu_s"] / rates[f"paper_{name}"]["rays_per_cpu_s"]
            for name in ("eager", "compiled")
        },
    }
    for db in THRESHOLDS_DB:
        times = [seconds_to(db, run["curve"]) for run in curves["ours"]]
        reached = [t for t in times if t is not None]
        ours = statistics.median(reached) if len(reached) == len(times) else None
        key = f"cpu_s_ratio_to_{db:g}_db".replace(".", "_")
        peer_s = seconds_to(db, curves["peer"]["curve"])
        figures[key] = over(peer_s, ours)
        if curves["paper"] is not None:
            figures[f"{key}_paper"] = over(peer_s, seconds_to(db, curves["paper"]["curve"]))
    figures |= {
        "rss_ratio": peer["peak_memory_bytes"]
        / max(r["peak_memory_bytes"] for r in (*rates["fast"], rates["default"])),
        "rss_ratio_paper": peer["peak_memory_bytes"] / rates["paper"]["peak_memory_bytes"],
        "fox_psnr": None,
        "fox_largest_drop_db": None,
        **{name: measured["kernels"][name] for name in ("mlp_fma_share", "mlp_useful_share", "encode_gather_share")},
        "growth_exponents": {
            name: found["exponent"] for name, found in measured["growth"].items() if isinstance(found, dict)
        },
    }
    if fox is not None:
        figures["fox_psnr"] = {mark: statistics.mean(run["psnr"][mark] for run in fox) for mark in fox[0]["psnr"]}
        figures["fox_largest_drop_db"] = max(run["largest_drop_db"] for run in fox)
    return figures


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fox", type=Path, metavar="FOLDER", help="transforms.json and images/")
    parser.add_argument("--preset", default="standard", help="of pipeline.yaml, for fox_psnr")
    parser.add_argument(
        "--long", action="store_true", help="fox_psnr on to ten times the CPU seconds; paper to 18.4 dB"
    )
    parser.add_argument("--quick", action="store_true", help="every part, too short for its figures to mean anything")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--work", type=Path, default=REPOSITORY / ".cache" / "radiance-bench", help="posed captures")
    parser.add_argument("--peer", type=Path, default=PEER, help="Python of the peer's environment")
    options = parser.parse_args()
    if not options.peer.exists():
        parser.error(f"there is no {options.peer}; `make bench-radiance` installs the peer")
    if options.quick and options.out == RESULTS:
        parser.error("--quick figures are no results; give another file with --out")
    name = "fox" if options.fox else "demo"
    folder = options.work.resolve() / name
    scene.run_until("scene-analysis", options.fox or DEMO, REPOSITORY, folder)
    bench = Bench(options, folder)
    views = bench.ours("views")
    if not options.fox:
        print("without --fox FOLDER: fox_psnr stays null, and the peer is met on the demo capture", file=sys.stderr)
    measured: Figures = {
        "rates": bench.rates(),
        "curves": bench.curves(),
        "fox": bench.fox() if options.fox else None,
        "kernels": bench.kernels(),
        "growth": bench.growth(),
    }
    report = {
        "machine": this_machine().model_dump(),
        **commit(),
        "quick": options.quick,
        "scene": {"name": name, **views},
        "fox_preset": options.preset if options.fox else None,
        **headline(measured),
        "measured": measured,
    }
    options.out.parent.mkdir(exist_ok=True)
    options.out.write_text(json.dumps(report, indent=1) + "\n")
    print(json.dumps({key: value for key, value in report.items() if key != "measured"}, indent=1))


if __name__ == "__main__":
    main()
