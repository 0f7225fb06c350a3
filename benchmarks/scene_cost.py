"""What a scene costs on CPU nodes, and how fast a GPU has to be to cost the same, from the presets' measured figures.

python -m benchmarks.scene_cost --core-hour 0.04 --gpu-hour 2.00 [--preset standard] [--scenes 10000]

Prices are the reader's; any currency. A CPU node runs one stage at a time on all its cores, as was measured.
What a GPU makes of a stage was not measured: what is printed is the speed at which it breaks even.
"""

import argparse
import json
from pathlib import Path

from inpaint3d.contracts.models.pipeline import Pipeline

ROOT = Path(__file__).resolve().parents[1]
HOUR = 3600.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--core-hour", type=float, required=True, help="price of a core for an hour")
    parser.add_argument("--gpu-hour", type=float, required=True, help="price of a node with a GPU for an hour")
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--scenes", type=int, default=10_000)
    given = parser.parse_args()
    measured = json.loads((ROOT / "benchmarks" / "results" / "presets.json").read_text())[given.preset]
    cores = measured["machine"]["cores"]
    stages = Pipeline(ROOT / "pipeline.yaml").stages
    node = cores * given.core_hour
    print(f"| stage | wall s on {cores} cores | cost | can use a GPU |\n|---|---|---|---|")
    for name, wall in measured["wall_s_by_stage"].items():
        gpu = "yes" if stages[name].spec.gpu == "optional" else ""
        print(f"| {name} | {wall:.0f} | {wall / HOUR * node:.5f} | {gpu} |")
    wall = sum(measured["wall_s_by_stage"].values())
    on_gpu = sum(w for n, w in measured["wall_s_by_stage"].items() if stages[n].spec.gpu == "optional")
    print(f"| a scene | {wall:.0f} | {wall / HOUR * node:.4f} | |")
    print(f"| {given.scenes:,} scenes | | {given.scenes * wall / HOUR * node:,.0f} | |")
    busy = measured["cpu_s"] / (wall * cores)
    said = (
        f"{busy:.0%} of the core seconds are used: nodes that several scenes keep busy cost that share of it.",
        f"{on_gpu / wall:.0%} of the time is in stages that can use a GPU; one costs the same as the cores where it is",
        f"{given.gpu_hour / node:.0f} times as fast as they are.",
    )
    print("\n" + "\n".join(said))


if __name__ == "__main__":
    main()
