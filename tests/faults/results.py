"""The figures of all fault trials in one file: each program writes what it counted, and keeps what others did."""

import collections
import json
import sys
from pathlib import Path
from typing import Any


def read_section(section: str, out: Path | None) -> dict[str, Any]:
    """What a program has written into the file before; nothing where there is none."""
    return json.loads(out.read_text()).get(section, {}) if out is not None and out.exists() else {}


def conclude_trials(
    section: str, seed: int, counts: collections.Counter[str], faults: list[str], out: Path | None, *, add: bool
) -> None:
    """Conclude trials that are drawn from a seed; with `add`, together with those that the file has already."""
    before = read_section(section, out) if add else {}
    trials = counts + collections.Counter(before.get("trials", {}))
    figures = {"seeds": [*before.get("seeds", []), seed], "trials": dict(sorted(trials.items()))}
    conclude(section, figures, [*before.get("faults", []), *faults], out)


def conclude(section: str, figures: dict[str, Any], faults: list[str], out: Path | None) -> None:
    """Print a section with its faults, put it into the file `out` where one is given, and exit: 1 where faults are."""
    made = {section: figures | {"failed": len(faults), "faults": faults[:50]}}
    sys.stdout.write(json.dumps(made, indent=2) + "\n")
    if out is not None:
        kept = json.loads(out.read_text()) if out.exists() else {}
        out.write_text(json.dumps(kept | made, indent=2) + "\n")
    sys.exit(bool(faults))
