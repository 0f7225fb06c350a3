"""Writes the tables of docs/stability.md from the catalogue and the faults: `python -m tests.stability.write_docs`."""

import importlib
import itertools
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

from benchmarks.pages import fill_between

from tests.stability.catalogue import HardCase

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/stability.md"
MODULES = ("rendering", "fields", "diffusion", "metrics", "geometry", "files", "parameters")


def list_cases() -> Iterator[tuple[str, HardCase, int]]:
    """`module::test`, its row, and how many cases its parameters make."""
    for module in MODULES:
        for name, test in vars(importlib.import_module(f"tests.stability.test_{module}")).items():
            if isinstance(test, FunctionType) and (row := getattr(test, "hard_case", None)) is not None:
                yield f"{module}::{name.removeprefix('test_')}", row, _count(test)


def _count(test: FunctionType) -> int:
    count = 1
    for mark in getattr(test, "pytestmark", []):
        count *= len(mark.args[1]) if mark.name == "parametrize" else 1
    return count


def write_cases() -> str:
    """The catalogue, a table for each area."""
    cases = sorted(list_cases(), key=lambda c: c[1].area)
    parts = [f"{sum(c[2] for c in cases)} cases in {len(cases)} tests of `tests/stability`.\n"]
    for area, rows in itertools.groupby(cases, key=lambda c: c[1].area):
        parts.append(f"### {area}\n")
        parts.append(
            "| what goes wrong otherwise | what is done | swept | what a user is told | cases |\n|---|---|---|---|---|"
        )
        parts += [
            f"| {_cell(row.plain)} | {_cell(row.ours)} | {_cell(row.swept)} | {_cell(row.told) or '-'} | "
            f"{count}: `{name}` |"
            for name, row, count in rows
        ]
        parts.append("")
    return "\n".join(parts)


FAULTS = {
    "faults": ("tests.stability.test_faults", "put in at the third and at the last step | the message says"),
    "joint-faults": (
        "tests.stability.test_joint_faults",
        "put in at the third and at the last step | the message says",
    ),
    "prior-faults": (
        "tests.stability.test_prior_faults",
        "put in at the third and at the last step | the message says",
    ),
    "stage-faults": ("tests.stability.stage_faults", "put in | the message says (exit code 3)"),
}
"""Table of the page -> where its faults stand, and its header."""


def write_faults(table: str) -> str:
    """What was put in, and what is said."""
    module, header = FAULTS[table]
    faults = importlib.import_module(module).FAULTS
    lines = [f"| {header} |", "|---|---|"]
    lines += [f"| {fault.what} | {_cell(f'`{_readable(fault.said)}`')} |" for fault in faults]
    return "\n".join(lines) + "\n"


def write_invariance() -> str:
    """Figures of `benchmarks.invariance`, as far as they were measured."""
    found = json.loads((ROOT / "benchmarks/results/invariance.json").read_text())
    lines = ["| the world | PSNR, dB | depth error | mask IoU |", "|---|---|---|---|"]
    rows = {**found["worlds"], **{f"another seed ({i})": s for i, s in enumerate(found["seeds"]) if i}}
    rows |= {f"{steps} steps": scores for steps, scores in found.get("long", {}).items()}
    lines += [
        f"| {name} | {row['psnr']:.2f} | {row['depth_error']:.4f} | {row['mask_iou']:.3f} |"
        for name, row in rows.items()
    ]
    return "\n".join(lines) + "\n"


def _readable(pattern: str) -> str:
    """A regular expression as the text that it stands for."""
    return re.sub(r"\\d\+?", "N", pattern.replace(".*", " ... ")).replace("\\", "")


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def fill_page(text: str) -> str:
    """The page with its tables as they are now, between their marks."""
    tables = {
        "cases": write_cases(),
        **{table: write_faults(table) for table in FAULTS},
        "invariance": write_invariance(),
    }
    for name, table in tables.items():
        text = fill_between(text, name, f"\n{table}")
    return text


if __name__ == "__main__":
    PAGE.write_text(fill_page(PAGE.read_text()))
