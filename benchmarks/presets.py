"""What each preset costs and wins on the demo capture: `python -m benchmarks.presets [--run PRESET ...]`.

`--run` runs the presets named (each from nothing, in a store of its own) and writes `benchmarks/results/presets.json`;
without it, only the README's table is written again from that file.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.pages import fill_between
from benchmarks.provenance import REPOSITORY

from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.configure import Settings, configure

RESULTS = REPOSITORY / "benchmarks" / "results" / "presets.json"
FIGURES = ("psnr", "ssim", "lpips_vgg")
PROTOCOL = "bbox10-vgg"
PRESETS = ("draft", "standard", "high", "paper")


def measure(preset: str) -> dict:
    """Run the demo under a preset; what it took and how it scored."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(
            [
                str(Path(sys.executable).parent / "inpaint3d"), "run", "examples/demo/capture",
                "--mask", "examples/demo/mask.yaml", "--name", preset, "--preset", preset, "--compare",
                "--store", f"{folder}/store", "--runs-dir", f"{folder}/runs",
            ],
            cwd=REPOSITORY, check=True,
        )  # fmt: skip
        return summarize(preset, json.loads((Path(folder) / "runs" / preset / "metrics.json").read_text()))


def summarize(preset: str, report: dict) -> dict:
    """The figures of the table from a run's metrics.json."""
    protocol = next(p for p in report["protocols"] if p["name"] == PROTOCOL)
    # The scores have the controls too; the costs are those of the nodes that run without --compare.
    given = ("capture", "mask-request", "pretrained-prior")
    left_out = configure(Pipeline(REPOSITORY / "pipeline.yaml"), Settings(preset), given).left_out
    stages = [s for s in report["stages"] if s["status"] != "left-out" and s["node"] not in left_out]
    methods: dict[str, dict[str, float]] = {}
    for metric in protocol["metrics"]:
        methods.setdefault(metric["method"], {})[metric["name"]] = metric["value"]
    return {
        "machine": report["machine"],
        "cpu_s": round(sum(s["cpu_s"] for s in stages), 1),
        "wall_s_by_stage": {s["node"]: s["wall_s"] for s in stages},
        "peak_memory_mib": round(max(s["peak_memory_bytes"] for s in stages) / 2**20),
        "scores": {method: {name: scores[name] for name in FIGURES} for method, scores in methods.items()},
    }


def table(results: dict) -> str:
    """The README's table."""
    machine = next(iter(results.values()))["machine"]
    lines = [
        f"{machine['processor']}, {machine['cores']} cores; scores in the hole's box against the truth views.",
        "",
        "| preset | sum of stages, minutes | CPU minutes | peak memory | PSNR | SSIM | LPIPS (VGG) |",
        "|---|---|---|---|---|---|---|",
    ]
    for preset in (p for p in PRESETS if p in results):
        r = results[preset]
        wall = sum(r["wall_s_by_stage"].values()) / 60
        s = next(iter(r["scores"].values()))
        lines.append(
            f"| {preset} | {wall:.1f} | {r['cpu_s'] / 60:.1f} | {r['peak_memory_mib']} MiB "
            f"| {s['psnr']:.2f} | {s['ssim']:.3f} | {s['lpips_vgg']:.3f} |"
        )
    if "standard" in results:
        lines += ["", "What each part is worth under `standard`, on the same crops:", ""]
        lines += ["| what is shown in the hole | PSNR | SSIM | LPIPS (VGG) |", "|---|---|---|---|"]
        lines += [
            f"| {method} | {s['psnr']:.2f} | {s['ssim']:.3f} | {s['lpips_vgg']:.3f} |"
            for method, s in results["standard"]["scores"].items()
        ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--run", nargs="*", default=[], metavar="PRESET")
    parser.add_argument("--from-run", nargs=2, action="append", default=[], metavar=("PRESET", "METRICS"))
    options = parser.parse_args()
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    for preset in options.run:
        results[preset] = measure(preset)
    for preset, path in options.from_run:
        results[preset] = summarize(preset, json.loads(Path(path).read_text()))
    RESULTS.parent.mkdir(exist_ok=True)
    RESULTS.write_text(json.dumps(results, indent=1) + "\n")
    readme = REPOSITORY / "README.md"
    readme.write_text(fill_between(readme.read_text(), "presets", f"\n{table(results)}\n"))


if __name__ == "__main__":
    main()
