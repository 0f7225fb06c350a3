"""The points of a study one after another: drawn by a space-filling design, run as anybody would run them."""

import json
import shlex
import subprocess
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
from inpaint3d.contracts.models.report import RunReport, StageFigures
from inpaint3d.contracts.store import Store, open_store
from inpaint3d.orchestrator.study.points import Point, StageCost, StudyResults, is_beaten, read_results
from inpaint3d.orchestrator.study.space import Drawn, StudySpec, list_assignments

if TYPE_CHECKING:
    from optuna import Study, Trial

PROBED = "nerf-pretraining"
PROBE = tuple(f"{PROBED}.{p}" for p in ("steps=40", "view_side=16", "rays=512", "first_rays=512", "score_every=40"))
"""A fit of a few seconds, by which a machine and a capture are compared with those of a study."""

POINTS, JOURNAL = "points.json", "journal.log"
FIELD = "radiance-field"


@dataclass(frozen=True)
class Bed:
    """What all points of a study share: capture, request, store (and so the work upstream), where results go."""

    capture: Path
    mask: Path | None
    store: str
    runs_dir: Path
    out: Path
    stub: bool = False

    @property
    def results_path(self) -> Path:
        return self.out / POINTS

    def load_results(self) -> StudyResults:
        """What earlier calls measured."""
        if self.results_path.exists():
            return read_results(self.results_path)
        return StudyResults(capture=str(self.capture))


def sweep(spec: StudySpec, bed: Bed, count: int, seed: int) -> Iterator[Point]:
    """Measure the presets and then drawn points until there are `count` of these; go on where an earlier call ended.

    Each point is written to `points.json` before the next is drawn. Raises ConfigurationError where Optuna is missing.
    """
    bed.out.mkdir(parents=True, exist_ok=True)
    results = bed.load_results()
    if results.probe_cpu_s is None and not bed.stub:
        results.model_copy(update={"probe_cpu_s": measure_probe(bed)}).write(bed.results_path)
    known = {p.name for p in results.points}
    for preset in spec.presets:
        if preset not in known:
            yield measure(spec, bed, preset, preset, {})
    study = open_design(bed.out / JOURNAL, seed)
    for trial in _draw(study, spec, count):
        point = measure(spec, bed, f"point-{trial.number:03d}", spec.preset, _read_trial(spec, trial))
        _tell(study, trial.number, point)
        yield point


def measure(spec: StudySpec, bed: Bed, name: str, preset: str, drawn: Drawn) -> Point:
    """Run one point, first to the stage that it is judged after, and keep what came out."""
    results = bed.load_results()
    command = write_command(spec, bed, name, preset, drawn)
    begun = Point(name=name, state="failed", preset=preset, knobs=dict(drawn), command=shlex.join(command))
    point = _run(bed, begun, [*command, "--until", spec.judge])
    if point.error is None and drawn and is_beaten(point, results.measured, spec.judge, spec.margin_db):
        point = point.model_copy(update={"state": "stopped-early"})
    elif point.error is None:
        point = _run(bed, begun, [*command, "--until", spec.until])
    report = _read_report(bed, name)
    update: dict[str, Any] = {"machine": report.machine} if report else {}
    if report and report.protocols:
        update["protocol"] = report.protocols[0].name
    results.model_copy(update=update).with_point(point).write(bed.results_path)
    return point


def measure_probe(bed: Bed) -> float | None:
    """CPU seconds of the probe's stage, whose field cannot be right; None where it fails, as the first point will."""
    words = [part for a in PROBE for part in ("--set", a)]
    mask = ["--mask", str(bed.mask)] if bed.mask else []
    command = [
        "inpaint3d",
        "run",
        str(bed.capture),
        *mask,
        *words,
        "--name",
        "study-probe",
        "--until",
        PROBED,
        "--accept-doubtful",
    ]
    point = _run(bed, Point(name="probe", state="failed", preset="", command=shlex.join(command)), command)
    return point.stages[PROBED].cpu_s if point.error is None else None


def write_command(spec: StudySpec, bed: Bed, name: str, preset: str, drawn: Drawn) -> list[str]:
    """The command line that measures a point, and that reproduces it."""
    assignments = [part for a in list_assignments(spec, drawn) for part in ("--set", a)]
    return [
        "inpaint3d", "run", str(bed.capture), *(["--mask", str(bed.mask)] if bed.mask else []),
        "--preset", preset, *assignments, "--name", f"study-{name}",
    ]  # fmt: skip


def open_design(journal: Path, seed: int) -> "Study":
    """The design of a study: scrambled Sobol points, kept in a journal from which the next call goes on."""
    try:
        import optuna
    except ModuleNotFoundError as error:
        raise ConfigurationError("a study needs Optuna; install inpaint3d-orchestrator[study]") from error
    from optuna.storages.journal import JournalFileBackend

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.QMCSampler(
            seed=seed, scramble=True, warn_independent_sampling=False, warn_asynchronous_seeding=False
        )
    storage = optuna.storages.JournalStorage(JournalFileBackend(str(journal)))
    return optuna.create_study(
        storage=storage, sampler=sampler, study_name="study", directions=["minimize", "maximize"], load_if_exists=True
    )


def _draw(study: "Study", spec: StudySpec, count: int) -> "Iterator[Trial]":
    """Trials up to `count`; what was cut short or failed in an earlier call is tried again first, once."""
    from optuna.trial import TrialState

    for cut in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(cut.number, state=TrialState.FAIL)
    earlier = study.get_trials(deepcopy=False)
    for trial in earlier:
        if trial.state == TrialState.FAIL and all(t.params != trial.params for t in earlier[trial.number + 1 :]):
            study.enqueue_trial(trial.params)
    failed = sum(t.state == TrialState.FAIL for t in earlier)
    # What fails in this call counts, or a stage that always fails would be tried for ever.
    while len(study.get_trials(deepcopy=False)) - failed - _count_waiting(study) < count:
        yield study.ask(list_distributions(spec))


def _count_waiting(study: "Study") -> int:
    from optuna.trial import TrialState

    return len(study.get_trials(deepcopy=False, states=(TrialState.WAITING,)))


def list_distributions(spec: StudySpec) -> dict[str, Any]:
    """Optuna's ranges: a list of choices is drawn by position, so that the design fills every dimension alike."""
    from optuna.distributions import IntDistribution

    return {
        name: IntDistribution(0, len(knob.choices) - 1)
        if knob.choices
        else IntDistribution(knob.low or 1, knob.high or 1, log=knob.log)
        for name, knob in spec.knobs.items()
    }


def _read_trial(spec: StudySpec, trial: "Trial") -> Drawn:
    drawn: dict[str, int] = trial.params
    return {name: knob.choices[drawn[name]] if knob.choices else drawn[name] for name, knob in spec.knobs.items()}


def _tell(study: "Study", number: int, point: Point) -> None:
    from optuna.trial import TrialState

    if point.state == "done":
        study.tell(number, [point.sum_seconds(), point.figures["psnr"]])
    else:
        study.tell(number, state=TrialState.PRUNED if point.state == "stopped-early" else TrialState.FAIL)


def _run(bed: Bed, begun: Point, command: list[str]) -> Point:
    """Run a command line with what only the measuring needs, and read what it left."""
    program = Path(sys.executable).with_name(command[0])
    places = ["--store", bed.store, "--runs-dir", str(bed.runs_dir), "--replace", "--log-format", "json"]
    bed.runs_dir.mkdir(parents=True, exist_ok=True)
    with (bed.runs_dir / f"study-{begun.name}.log").open("ab") as log:
        done = subprocess.run(
            [str(program), *command[1:], *places, *(["--stub"] if bed.stub else [])],
            check=False, stdout=log, stderr=subprocess.STDOUT,
        )  # fmt: skip
    report = _read_report(bed, begun.name)
    if done.returncode != 0 or report is None:
        return begun.model_copy(update={"error": f"exit {done.returncode}; see {log.name}"})
    costs = _collect_costs(bed, report)
    return begun.model_copy(update={"state": "done", "stages": costs, "figures": read_figures(report)})


def _read_report(bed: Bed, name: str) -> RunReport | None:
    path = bed.runs_dir / f"study-{name}" / "metrics.json"
    return RunReport.model_validate(json.loads(path.read_text())) if path.exists() else None


def read_figures(report: RunReport) -> dict[str, float]:
    """The result's figures under the protocol that stands first: the hole's where there is truth."""
    if not report.protocols:
        return {}
    metrics = report.protocols[0].metrics
    return {m.name: m.value for m in metrics if m.method == metrics[0].method}


def _collect_costs(bed: Bed, report: RunReport) -> dict[str, StageCost]:
    store = open_store(bed.store)
    costs: dict[str, StageCost] = {}
    for stage in report.stages:
        if stage.wall_s is None or stage.cpu_s is None:
            continue
        psnr = steps_s = None
        if digest := stage.outputs.get(FIELD):
            psnr = store.open(digest, RadianceFieldArtifact).metadata.held_out_psnr
            steps_s = _find_last_score(store, stage)
        costs[stage.node] = StageCost(
            wall_s=stage.wall_s, cpu_s=stage.cpu_s, peak_memory_bytes=stage.peak_memory_bytes or 0,
            held_out_psnr=psnr, steps_cpu_s=steps_s,
        )  # fmt: skip
    return costs


def _find_last_score(store: Store, stage: StageFigures) -> float | None:
    found = None if stage.key is None else store.lookup(stage.key, verify=False)
    rows: list[dict[str, Any]] = [] if found is None else found.timings.get("series", {}).get("learning_curve", [])
    return rows[-1]["cpu_s"] if rows else None
