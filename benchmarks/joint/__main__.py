"""What fills a hole best: `make bench-joint [STATUE=FOLDER] [BEAR=FOLDER]`.

    python -m benchmarks.joint [--statue FOLDER] [--bear FOLDER] [--scenes SCENE ...] [--rows ROW ...]
                               [--seeds N ...] [--quick] [--threads N] [--work DIR] [--out FILE]

Writes `benchmarks/results/joint.json`, its table beside it, and prints that. Every row takes the same capture, mask,
masked reconstruction and, where it asks one, prior through the stages view-completion (where it fits completed views)
and joint-optimization, with three seeds of these. Rows, holes and the rule for the default stand in rows.py.

Rows can be run one by one: what is done lies in the store below --work and is found there, what was killed goes on from
its checkpoint, and the file is written after every row, one seed of all rows before the next. What a step of score
distillation costs beyond its parts is measured too, in a second or two (cost.py). Pictures of each row lie in
--work/pictures, to be looked at.
Figures of scenes and rows that are not asked for stay as they were; each has its commit and the key of its run. Two of
these with different --scenes can run side by side (--threads).

--statue, --bear: folders with images/, photos of a scene (in the project's own table 29 of a statue, 96 of a bear). Of
the bear only the baselines and the default by the rule are run. --quick: minutes, a small budget and one seed, to see
that it works; its figures mean nothing.
"""

import argparse
import fcntl
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.joint.cost import sds_step
from benchmarks.joint.rows import (
    BASELINES,
    FIGURES,
    HOLES,
    PHOTOS_MASK,
    ROWS,
    RULE,
    RULED,
    SEEDS,
    TRUTH_EVERY,
    TRUTH_FIRST,
    Figures,
    Measured,
    Parameters,
    chosen,
    find_row,
    mean,
    shortfalls,
    spread,
)
from benchmarks.provenance import commit

from inpaint3d.contracts.kit.context import Inputs
from inpaint3d.contracts.kit.invocation import Invocation
from inpaint3d.contracts.models.artifacts import Evaluation
from inpaint3d.contracts.models.pipeline import Pipeline, merge_parameters
from inpaint3d.contracts.store import FolderStore, Record
from inpaint3d.orchestrator.history import History, this_machine
from inpaint3d.orchestrator.parameters import resolve_parameters
from inpaint3d.orchestrator.prune import find_unread_ports

REPOSITORY = Path(__file__).resolve().parents[2]
RESULTS = REPOSITORY / "benchmarks" / "results" / "joint.json"
FORMATS = {"psnr": ".2f", "fd_lite0": ".0f", "gradient_share": ".2f", "wall_s": ".0f", "cpu_s": ".0f"}
WORK = REPOSITORY / ".cache" / "bench-joint"
DEMO = REPOSITORY / "examples" / "demo"
COMPLETION, JOINT, EVALUATION = "view-completion", "joint-optimization", "evaluation"
PRIOR = "diffusion-training.diffusion-prior"
QUICK = {
    "nerf-pretraining": {"steps": 60, "view_side": 80},
    "diffusion-training": {"steps": 4},
    "masked-reconstruction": {"steps": 60, "view_side": 80},
    JOINT: {"steps": 12, "score_every": 6, "terms_every": 6, "view_side": 40},
    EVALUATION: {
        "render_longest_side": 96, "truth_views": 2, "held_out_views": 1, "picture_views": 1, "neighbour_views": 1,
    },
}  # fmt: skip


class Bench:
    """One capture with what comes before the joint optimisation, made once."""

    def __init__(self, scene: str, capture: Path, mask: Path, work: Path, *, quick: bool, threads: int) -> None:
        self.scene, self.work, self.threads = scene, work, threads
        self.pipeline, self.store = Pipeline(REPOSITORY / "pipeline.yaml"), FolderStore(work / "store")
        self.changes: dict[str, Parameters] = QUICK if quick else {}
        self.outputs: dict[str, str] = {}
        self._command = [
            str(Path(sys.executable).parent / "inpaint3d"), "run", str(capture), "--mask", str(mask), "--name", scene,
            "--store", str(work / "store"), "--runs-dir", str(work / "runs"),
        ]  # fmt: skip
        self._make("masked-reconstruction")

    def measure(self, row: str, seed: int) -> dict[str, Any]:
        """Figures of a row with a seed, and what the stage took."""
        chosen = find_row(row, self.pipeline.parameters(JOINT, "paper"))
        made = [] if chosen.completion is None else [self._run(COMPLETION, chosen.completion, seed)]
        completed = {f"{COMPLETION}.completed-views": record.outputs["completed-views"] for record in made}
        joint = self._run(JOINT, chosen.joint, seed, completed)
        scored = self._score(joint.outputs["radiance-field"])
        evaluation = self.store.open(scored.outputs["evaluation"], Evaluation)
        shown = self.work / "pictures" / self.scene / f"{row}-{seed}"
        shutil.rmtree(shown, ignore_errors=True)
        shutil.copytree(evaluation.root / "pictures", shown)
        label = evaluation.metadata.protocols[0].metrics[0].method
        figures: dict[str, Any] = {
            m.name: m.value
            for protocol in evaluation.metadata.protocols
            for m in protocol.metrics
            if m.method == label and FIGURES.get(m.name) == protocol.name
        }
        took = {name: sum(record.timings[name] for record in (*made, joint)) for name in ("wall_s", "cpu_s")}
        of = {"seed": seed, "key": joint.key, "commit": commit()["commit"], "processor": this_machine().processor}
        return figures | took | of

    def _score(self, field: str) -> Record:
        """The evaluation of one field alone, without what is said of the prior."""
        parameters = self._resolve(EVALUATION, {})
        inputs = self._inputs(EVALUATION, parameters, self.outputs) | {"radiance-fields": [field]}
        inputs.pop("diffusion-prior", None)
        return self._start(EVALUATION, parameters, inputs, 0)

    def sds_step(self) -> dict[str, Any]:
        """What a step of score distillation costs here, in CPU seconds (cost.py)."""
        stage = self.pipeline.stages[JOINT]
        parameters = self._resolve(JOINT, {"estimator": "sds"})
        return sds_step(Inputs(self.store, stage, self._inputs(JOINT, parameters, self.outputs)), guidance=1.0)

    def _make(self, until: str) -> None:
        # Settings of a node that does not run are refused.
        changes = {n: p for n, p in self.changes.items() if n == until or until in self.pipeline.downstream(n)}
        settings = [word for n, p in changes.items() for k, v in p.items() for word in ("--set", f"{n}.{k}={v}")]
        subprocess.run([*self._command, *settings, "--until", until], cwd=REPOSITORY, check=True)
        for node in History(self.store).latest(self.scene).nodes:
            self.outputs |= {f"{node.node}.{port}": digest for port, digest in node.outputs.items()}

    def _resolve(self, node: str, changes: Parameters) -> Parameters:
        chosen = merge_parameters(self.pipeline.parameters(node, None), changes)
        return resolve_parameters(self.pipeline, node, merge_parameters(chosen, self.changes.get(node, {})))

    def _inputs(self, node: str, parameters: Parameters, outputs: Mapping[str, str]) -> dict[str, Any]:
        """Port -> digest, of what the stage reads under these parameters; a prior is trained where one is asked."""
        unread = {u.port for u in find_unread_ports(self.pipeline, node, parameters, ())}
        wired = {p: refs for p, refs in self.pipeline.references(node).items() if p not in unread}
        ports = self.pipeline.stages[node].spec.inputs
        if node != EVALUATION and wired.get("diffusion-prior") and PRIOR not in outputs:
            self._make("diffusion-training")
            outputs = {**self.outputs, **outputs}
        found = {port: [outputs[r] for r in references if r in outputs] for port, references in wired.items()}
        return {port: ds if ports[port].list else ds[0] for port, ds in found.items() if ds}

    def _run(self, node: str, changes: Parameters, seed: int, extra: Mapping[str, str] | None = None) -> Record:
        """A stage as the scheduler would start it, `extra` (reference -> digest) over what was made before."""
        parameters = self._resolve(node, changes)
        return self._start(node, parameters, self._inputs(node, parameters, {**self.outputs, **(extra or {})}), seed)

    def _start(self, node: str, parameters: Parameters, inputs: dict[str, Any], seed: int) -> Record:
        invocation = Invocation(
            parameters=parameters, inputs=inputs, seed=seed, threads=self.threads, accept_doubtful=True
        )
        module = self.pipeline.stages[node].spec.module
        with tempfile.NamedTemporaryFile("w", suffix=".json") as file:
            file.write(invocation.model_dump_json())
            file.flush()
            command = ["-m", module, "run", "--store", str(self.store.root), "--invocation", file.name]
            done = subprocess.run([sys.executable, *command], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
        last = json.loads(done.stdout.splitlines()[-1])
        if done.returncode != 0:
            raise SystemExit(f"{node} of {self.scene} failed with exit code {done.returncode}: {last.get('message')}")
        record = self.store.lookup(last["key"])
        if record is None:
            raise SystemExit(f"{node} of {self.scene} left no record of {last['key']}; run it again")
        return record


def photos_capture(scene: str, photos: Path, work: Path) -> tuple[Path, Path]:
    """The photos as a capture with truth beside it, and the request for its hole, by the rule in rows.py."""
    pictures = sorted(p for p in (photos / "images").glob("*") if p.suffix.lower() in (".jpg", ".jpeg", ".png"))
    if len(pictures) < 2 * TRUTH_EVERY:
        raise SystemExit(f"--{scene} {photos}: images/ holds {len(pictures)} photos; give at least {2 * TRUTH_EVERY}")
    folder = work / "captures" / scene
    shutil.rmtree(folder, ignore_errors=True)
    for i, picture in enumerate(pictures):
        target = folder / ("truth" if i % TRUTH_EVERY == TRUTH_FIRST else "images")
        target.mkdir(parents=True, exist_ok=True)
        shutil.copy(picture, target)
    mask = work / "captures" / f"{scene}.yaml"
    mask.write_text(PHOTOS_MASK)
    return folder, mask


def table(result: dict[str, Any]) -> str:
    """The file in words: mean and spread over the seeds, a table for each scene, and what the rule says."""
    names, measured = (*FIGURES, "wall_s", "cpu_s"), result["measured"]
    default = result["default"]
    lines = [
        "Mean ± standard deviation over the seeds. `wall_s`, `cpu_s`: seconds of view-completion (where the row fits "
        "completed views) and joint-optimization, "
        f"{result['machine']['cores']} cores of the row's processor.",
        "",
    ]
    for scene, rows in measured.items():
        lines += [
            f"{scene}: {HOLES[scene]}",
            "",
            f"| row | seeds | {' | '.join(names)} | processor |",
            "|---" * (len(names) + 3) + "|",
        ]
        for row in (r for r in ROWS if r in rows):
            cells = [cell(rows[row], name) for name in names]
            processors = ", ".join(sorted({run["processor"] for run in rows[row]}))
            lines.append(f"| {row} | {len(rows[row])} | {' | '.join(cells)} | {processors} |")
        lines.append("")
    if step := result["sds_step"]:
        lines += [f"A step of `sds` takes {step['ratio']:.2f} times what its render and its prior take (cost.py).", ""]
    lines += [f"Rule: {RULE}", "", f"By it the default is `{default['row']}`. What it does not reach:", ""]
    lines += [f"- {shortfall}" for shortfall in default["shortfalls"]] or ["- nothing"]
    return "\n".join(lines)


def cell(runs: list[Figures], name: str) -> str:
    form = FORMATS.get(name, ".3f")
    spread_of = f" ± {spread(runs, name):{form}}" if len(runs) > 1 else ""
    return f"{mean(runs, name):{form}}{spread_of}"


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
    result = read(out)
    out.with_suffix(".md").write_text(table(result) + "\n")
    print(table(result))


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
