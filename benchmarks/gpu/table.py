"""What was measured on a GPU, for the repository: python -m benchmarks.gpu.table FOLDER ... --commit HASH

FOLDERs are where runs of `benchmarks.gpu` on one machine wrote their results; of a figure that several have, the last
one's counts. Writes `benchmarks/results/gpu.json` and its tables in `docs/how-to/use-a-gpu.md`; without a FOLDER the
tables alone, from the file.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.pages import fill_between
from benchmarks.provenance import REPOSITORY

RESULTS = REPOSITORY / "benchmarks" / "results" / "gpu.json"
PAGE = REPOSITORY / "docs" / "how-to" / "use-a-gpu.md"
Figures = dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--commit", help="that the pack was made of (its packed.json)")
    options = parser.parse_args()
    if options.folders:
        results = join([json.loads((folder / "results.json").read_text()) for folder in options.folders])
        RESULTS.write_text(json.dumps({"commit": options.commit, **results}, indent=1) + "\n")
    results = json.loads(RESULTS.read_text())
    PAGE.write_text(fill_between(PAGE.read_text(), "gpu", "\n" + tabulate(results) + "\n"))


def join(runs: list[Figures]) -> Figures:
    """The figures of several runs, by part."""
    joined: dict[str, Figures] = {}
    for run in runs:
        for part, figures in run.items():
            joined.setdefault(part, {}).update(figures)
    return joined


def tabulate(results: Figures) -> str:
    """The page's tables."""
    machine, rates, prior = results["machine"]["machine"], dict(results["rates"]), results["prior"]
    trained = prior["trained"]
    own = rates.pop("machine's own")
    return "\n".join(
        [
            f"{machine['gpu']}, {machine['cores']} cores, torch {machine['torch']}; "
            f"commit {results['commit'][:7]}; `benchmarks/results/gpu.json`.",
            "",
            "| against the processor | error | allowed | |",
            "|---|---|---|---|",
            *[describe_check(name, check) for name, check in results["correctness"].items()],
            "",
            "| rate | |",
            "|---|---|",
            f"| the machine's own | {own['bf16_tflops']:.0f} TFLOP/s in bf16, copies {own['copy_gb_s']:.0f} GB/s |",
            *[describe_rate(name, rate) for name, rate in rates.items()],
            "",
            "| the prior's training | |",
            "|---|---|",
            f"| pictures | {prior['pictures']['training']}, and {prior['pictures']['held_out']} held out |",
            f"| samples | {trained['samples'] / 1e6:.2f} million in {trained['seconds']:.0f} s, "
            f"{trained['samples_per_s']:.0f} a second; steps lost: {sum(trained['non_finite'].values())} |",
            *[
                f"| {name}, held out | {row['hole_psnr']:.2f} dB in the hole |"
                for name, row in prior["table"].items()
                if isinstance(row, dict)
            ],
        ]
    )


def describe_check(name: str, check: Any) -> str:
    if not isinstance(check, dict):
        return f"| {name} | | | {check} |"
    if "failed" in check or "skipped" in check:
        return f"| {name} | | | {'**failed**, below' if 'failed' in check else check['skipped']} |"
    if "error" not in check:
        return f"| {name} | | {check['allowed']:g} | |"
    return f"| {name} | {check['error']:.2g} | {check['allowed']:g} | {'' if check['ok'] else '**too large**'} |"


def describe_rate(name: str, rate: Any) -> str:
    if not isinstance(rate, dict):
        return f"| {name} | {rate} |"
    said = {
        "samples_per_s": lambda value: f"{value:.0f} samples a second in batches of {rate['batch']}",
        "seconds_per_sample": lambda value: f"{1000 * value:.0f} ms by {rate['steps']} steps",
        "psnr_db_after_s": lambda value: ", ".join(f"{psnr:.2f} dB after {s} s" for s, psnr in value.items()),
        "rays_per_s": lambda value: f"{value / 1e6:.2f} million rays a second",
        "skipped": str,
        "failed": lambda value: f"**failed**: {value[:80]}",
    }
    return f"| {name} | {'; '.join(say(rate[figure]) for figure, say in said.items() if figure in rate)} |"


if __name__ == "__main__":
    main()
