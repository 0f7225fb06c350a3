"""One scene of the table: what comes before the joint optimisation, made once, and a row measured on it."""

import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.joint.cost import sds_step
from benchmarks.joint.rows import FIGURES, PHOTOS_MASK, TRUTH_EVERY, TRUTH_FIRST, Parameters, find_row
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
