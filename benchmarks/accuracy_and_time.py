"""`docs/accuracy-and-time.md` and its plots from `benchmarks/results/study`: `make accuracy-and-time`."""

import argparse
from pathlib import Path

from benchmarks.pages import fill_between
from benchmarks.provenance import REPOSITORY

from inpaint3d.orchestrator.study.plots import draw_plots, tabulate
from inpaint3d.orchestrator.study.points import read_results

STUDIES = REPOSITORY / "benchmarks" / "results" / "study"
PAGE = REPOSITORY / "docs" / "accuracy-and-time.md"
PICTURES = PAGE.parent / "pictures" / "study"


def describe(path: Path) -> str:
    """A study's section: what was measured, plots, every point and the commands of those that nothing beats."""
    results = read_results(path)
    folder = PICTURES / path.parent.name
    folder.mkdir(parents=True, exist_ok=True)
    drawn = draw_plots(results, folder)
    pictures = "\n".join(f"![{p.title}]({(folder / p.file).relative_to(PAGE.parent)})" for p in drawn)
    return f"## {path.parent.name}\n\n{tabulate(results, pictures)}"


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    sections = [describe(path) for path in sorted(STUDIES.glob("*/points.json"))]
    PAGE.write_text(fill_between(PAGE.read_text(), "study", "\n" + "\n".join(sections)))


if __name__ == "__main__":
    main()
