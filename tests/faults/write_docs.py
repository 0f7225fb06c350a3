"""Writes the tables of docs/reliability.md from what was measured: `python -m tests.faults.write_docs`."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from benchmarks.pages import fill_between

from tests.faults.kills import NOBODY, VICTIMS

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/reliability.md"
NAMES = {"inpaint3d": "inpaint3d", "dvc": "DVC", "snakemake": "Snakemake"}
TOLD = {
    "ENOSPC": "that the disk is full", "EIO": "that the disk fails", "EROFS": "that the disk is read-only",
    "EMFILE": "that too many files are open",
}  # fmt: skip


def _read(name: str) -> dict[str, Any]:
    return json.loads((ROOT / "benchmarks/results" / f"{name}.json").read_text())


def write_trials() -> str:
    """What was done how often, a row each; the last rows what no fault was expected of."""
    found = _read("reliability")
    lines = ["| what was done | times | failed |", "|---|---|---|"]
    lines += [f"| {what} | {times:,} | {failed} |" for what, times, failed in _list_trials(found)]
    return "\n".join(lines) + "\n"


def _list_trials(found: dict[str, Any]) -> Iterator[tuple[str, int, str]]:
    """A row of the table. A program that saw no fault failed at none of its rows; of one that did, none is claimed."""
    trials, training = found["kills and corruptions"], found["kills of training"]
    done, failed = trials["trials"], _failed(trials)
    for kind in sorted(k for k in done if k.startswith("corrupted ")):
        yield kind, done[kind], failed
    for whom in (*VICTIMS, "group"):
        yield f"killed {whom}, runs of no-op stages", done[f"killed {whom}"], failed
    ended = done["killed and run to its end"]
    yield "run to its end after kills, with the results of an undisturbed run", ended, failed
    yield "killed training of a field", training["trials"]["killed training"], _failed(training)
    ended = training["trials"]["killed and trained to its end"]
    yield "trained to its end after kills, with the same weights, bit for bit", ended, _failed(training)
    nobody = f"killed {NOBODY}"
    yield "kills that hit nobody: the process had ended", done[nobody] + training["trials"][nobody], "-"
    for what, times in found["write sites"]["writes"].items():
        kind, error = what.split()
        fault = (
            f"writes of a {kind} told {TOLD[error]}" if error in TOLD else f"a {kind} killed before one of its writes"
        )
        yield f"{fault}, all that it has", times, _failed(found["write sites"])
    inputs = found["damaged inputs"]["inputs"]
    total = sum(sum(outcomes.values()) for outcomes in inputs.values())
    yield f"damaged inputs of {len(inputs)} kinds, read or refused", total, _failed(found["damaged inputs"])
    gc = found["beside gc"]
    beside = f"beside a gc that ran {gc['gc ran']:,} times and found the store in use {gc['gc refused']:,} times"
    yield f"results committed by eight processes, {beside}", gc["results"], _failed(gc)


def _failed(section: dict[str, Any]) -> str:
    return str(section["failed"])


def write_kills() -> str:
    """How many kills hit somebody."""
    found = _read("reliability")
    done = found["kills and corruptions"]["trials"]
    hit = sum(done[f"killed {whom}"] for whom in (*VICTIMS, "group"))
    hit += found["kills of training"]["trials"]["killed training"]
    return f"{hit:,} kills hit somebody.\n"


def write_overhead() -> str:
    found = _read("overhead")
    lines = ["| | first run | second run |", "|---|---|---|"]
    lines += [
        f"| {_name(system, found)} | {row['first_cpu_s']:.2f} | {row['second_cpu_s']:.2f} |"
        for system, row in found["systems"].items()
    ]
    return "\n".join(lines) + "\n"


def write_peers() -> str:
    found = _read("peer_faults")
    header = ["killed: went on, with the right results", "bit flipped: found and mended", "bit flipped: unnoticed"]
    lines = ["| | " + " | ".join(header) + " |", "|---|---|---|---|"]
    for system, row in found["systems"].items():
        killed, flipped = row["killed"], row["bit flipped"]
        cells = [(killed, "went on"), (flipped, "found and mended"), (flipped, "unnoticed")]
        counts = [f"{row.get(outcome, 0)} of {sum(row.values())}" for row, outcome in cells]
        lines.append(f"| {_name(system, found)} | " + " | ".join(counts) + " |")
    return "\n".join(lines) + "\n"


def _name(system: str, found: dict[str, Any]) -> str:
    return f"{NAMES[system]} {found['versions'].get(system, '')}".strip()


def fill_page(text: str) -> str:
    """The page with its tables as they are now, between their marks."""
    tables = {
        "kills": write_kills(), "trials": write_trials(), "overhead": write_overhead(), "peers": write_peers(),
    }  # fmt: skip
    for name, table in tables.items():
        text = fill_between(text, name, f"\n{table}")
    return text


if __name__ == "__main__":
    PAGE.write_text(fill_page(PAGE.read_text()))
