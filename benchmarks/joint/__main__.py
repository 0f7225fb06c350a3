"""What fills a hole best: `make bench-joint [STATUE=FOLDER] [BEAR=FOLDER]`.

    python -m benchmarks.joint [--statue FOLDER] [--bear FOLDER] [--scenes SCENE ...] [--rows ROW ...]
                               [--seeds N ...] [--quick] [--threads N] [--work DIR] [--out FILE] [--against FILE]

Writes `benchmarks/results/joint.json`, its table beside it, and prints that. Every row takes the same capture, mask,
masked reconstruction and, where it asks one, prior through the stages view-completion (where it fits completed views)
and joint-optimization, with three seeds of these. Rows, holes and the rule for the default stand in rows.py.

Rows can be run one by one: what is done lies in the store below --work and is found there, what was killed goes on from
its checkpoint, and the file is written after every row, one seed of all rows before the next. What a step of score
distillation costs beyond its parts is measured too, in a second or two (cost.py). Pictures of each row lie in
--work/pictures, to be looked at.
Figures of scenes and rows that are not asked for stay as they were; each has its commit and the key of its run. Two of
these with different --scenes can run side by side (--threads).

--against: an earlier FILE of these; the table then says what became of the rows that both have. So was the committed
`joint_demo.md` made: --scenes demo --rows photo-completion no-prior inpaint-then-nerf sds --threads 1
--out benchmarks/results/joint_demo.json --against benchmarks/results/joint.json.
--statue, --bear: folders with images/, photos of a scene (in the project's own table 29 of a statue, 96 of a bear). Of
the bear only the baselines and the default by the rule are run. --quick: minutes, a small budget and one seed, to see
that it works; its figures mean nothing.
"""

import argparse
import fcntl
import json
import os
import sys
from pathlib import Path
from typing import Any

from benchmarks.joint.bench import REPOSITORY, Bench, photos_capture
from benchmarks.joint.rows import BASELINES, HOLES, ROWS, RULE, RULED, SEEDS, Measured, chosen, shortfalls
from benchmarks.joint.table import table

from inpaint3d.orchestrator.history import this_machine

RESULTS = REPOSITORY / "benchmarks" / "results" / "joint.json"
WORK = REPOSITORY / ".cache" / "bench-joint"
DEMO = REPOSITORY / "examples" / "demo"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--statue", type=Path, metavar="FOLDER")
    parser.add_argument("--bear", type=Path, metavar="FOLDER")
    parser.add_argument("--scenes", nargs="+", choices=HOLES, default=list(HOLES), metavar="SCENE")
    parser.add_argument("--rows", nargs="+", choices=ROWS, default=None, metavar="ROW")
    parser.add_argument("--seeds", nargs="+", type=int, default=None, metavar="N")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, metavar="N", help="of a stage")
    parser.add_argument("--work", type=Path, default=None)
    parser.add_argument("--out", type=Path, default=None)
    parser.add_argument("--against", type=Path, default=None, metavar="FILE")
    options = parser.parse_args()
    work = (options.work or (WORK.with_name("bench-joint-quick") if options.quick else WORK)).resolve()
    out = options.out or (work / "joint.json" if options.quick else RESULTS)
    seeds = options.seeds or ([SEEDS[0]] if options.quick else SEEDS)

    work.mkdir(parents=True, exist_ok=True)
    captures = {"demo": (DEMO / "capture", DEMO / "mask.yaml")} if "demo" in options.scenes else {}
    for scene, photos in (("statue", options.statue), ("bear", options.bear)):
        if photos is not None and scene in options.scenes:
            captures[scene] = photos_capture(scene, photos, work)
    if (kept := read(out)) and kept["quick"] != options.quick:
        raise SystemExit(f"{out} is of a run {'with' if kept['quick'] else 'without'} --quick; give another --out")
    for scene, (capture, mask) in captures.items():
        bench = Bench(scene, capture, mask, work, quick=options.quick, threads=options.threads)
        rows = options.rows or rows_of(scene, read(out))
        step = bench.sds_step() if scene == "demo" and "sds" in rows else None
        for seed in seeds:
            for row in rows:
                print(f"{scene}: {row}, seed {seed}", file=sys.stderr, flush=True)
                add(out, scene, row, bench.measure(row, seed), step, quick=options.quick)
    text = table(read(out), read(options.against) if options.against else {})
    out.with_suffix(".md").write_text(text + "\n")
    print(text)


def rows_of(scene: str, kept: dict[str, Any]) -> tuple[str, ...]:
    """All rows of a scene that the rule is about; of another one the baselines and what the rule chose."""
    if scene in RULED:
        return ROWS
    best = kept.get("default", {}).get("row")
    if best is None:
        raise SystemExit(f"{scene} is for the default row, and there is none yet; run {', '.join(RULED)} first")
    return (*BASELINES, best)


def read(out: Path) -> dict[str, Any]:
    """What the file holds; empty where there is none."""
    return json.loads(out.read_text()) if out.exists() else {}


def add(out: Path, scene: str, row: str, figures: dict[str, Any], step: dict[str, Any] | None, *, quick: bool) -> None:
    """Put a run into the file, and what the rule makes of all rows so far; step: a new cost of score distillation."""
    out.parent.mkdir(parents=True, exist_ok=True)
    folder = os.open(out.parent, os.O_RDONLY)
    try:
        # Another of these may be writing what it measured of another scene.
        fcntl.flock(folder, fcntl.LOCK_EX)
        kept = read(out)
        measured: Measured = kept.get("measured", {})
        rows = measured.setdefault(scene, {})
        others = [run for run in rows.get(row, []) if run["seed"] != figures["seed"]]
        rows[row] = sorted([*others, figures], key=lambda run: run["seed"])
        ruled = {scene: rows for scene, rows in measured.items() if scene in RULED}
        best = chosen(ruled)
        result = {
            "machine": this_machine().model_dump(mode="json"),
            "quick": quick,
            "holes": {scene: HOLES[scene] for scene in measured},
            "rule": RULE,
            "default": {"row": best, "shortfalls": shortfalls(ruled, best) if best else []},
            "sds_step": step or kept.get("sds_step", {}),
            "measured": measured,
        }
        staged = out.with_suffix(".new")
        staged.write_text(json.dumps(result, indent=1) + "\n")
        staged.replace(out)
    finally:
        os.close(folder)


if __name__ == "__main__":
    main()
