"""Run a scene within a budget: say what is expected, run fit by fit, cut the steps that are left, say what came out."""

import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.report import RunReport
from inpaint3d.orchestrator.budget.choice import (
    Expectation,
    Limits,
    Steps,
    choose_point,
    cut_steps,
    find_least_steps,
    learn_pace,
    list_costs,
    read_limits,
)
from inpaint3d.orchestrator.options import Budget, SceneRequest
from inpaint3d.orchestrator.plan import Selection, find_pipeline
from inpaint3d.orchestrator.publish import read_report
from inpaint3d.orchestrator.request import ConfiguredRequest
from inpaint3d.orchestrator.study.points import AFTER, Point, StudyResults, read_results
from inpaint3d.orchestrator.study.sweep import PROBE, PROBED, read_figures

STUDY = Path("benchmarks/results/study/demo/points.json")
CAMERAS = AFTER[-1]
Run = Callable[[SceneRequest, Selection, bool], int]
"""Runs what is asked for; the third: whether to go on where a result cannot be right, as the probe's cannot."""


def run_within(budget: Budget, request: SceneRequest, folder: Path, run: Run) -> int:
    """Run a scene within a budget; returns its exit code. `runs/NAME/budget.json` holds what was expected and came out.

    The clock begins when the cameras are known and the machine was probed. Cutting is done by a fit's steps before it
    starts: what it makes is the result of so many steps, under their key. What has started is not cut.
    Raises ConfigurationError for a limit that is none or that no point meets, BadInputError without a study.
    """
    if request.preset is not None:
        raise ConfigurationError(f"--preset {request.preset}: a budget chooses the settings; leave it out")
    limits = read_limits(budget.time_budget, budget.memory_budget, budget.target_psnr)
    results = read_results(budget.study or find_pipeline(request.pipeline).parent / STUDY)
    if not results.measured:
        raise BadInputError(f"the study of {results.capture} has no measured point; run `inpaint3d study` first")
    first = choose_point(results.measured, limits, 1.0).point
    if code := run(ask_for(request, first), Selection(until=CAMERAS), False):
        return code
    pace = _measure_pace(results, request, first, folder, run)
    alike = [p for p in results.measured if p.camera_settings == first.camera_settings]
    expected = choose_point(alike, limits, pace)
    _say(describe_expectation(expected, limits, pace))
    began = time.monotonic()
    steps: Steps = {}
    code = _run_by_fits(expected, alike, limits, pace, request, run, steps)
    _close(folder, limits, expected, steps, time.monotonic() - began, code)
    return code


def ask_for(request: SceneRequest, point: Point, further: Sequence[str] = ()) -> SceneRequest:
    """The request under a point's settings; what the command line itself sets comes last, and counts."""
    chosen = [*point.assignments, *further, *(request.assignments or [])]
    return dataclasses.replace(request, preset=point.preset, assignments=chosen)


def _measure_pace(results: StudyResults, request: SceneRequest, point: Point, folder: Path, run: Run) -> float:
    """Seconds here for a CPU second of the study, by the same fit of a few seconds; 1 where that cannot be told."""
    cameras = [a for a in point.assignments if a.split(".")[0] in AFTER]
    probe = dataclasses.replace(request, preset=point.preset, assignments=[*cameras, *PROBE])
    if results.probe_cpu_s is None or run(probe, Selection(until=PROBED), True):
        _say("no probe: the study's own seconds are taken")
        return 1.0
    return _find_seconds(folder, [PROBED]) / results.probe_cpu_s


def _find_seconds(folder: Path, nodes: Sequence[str]) -> float:
    return sum(s["wall_s"] or 0.0 for s in read_report(folder)["stages"] if s["node"] in nodes)


def _run_by_fits(
    expected: Expectation,
    points: Sequence[Point],
    limits: Limits,
    pace: float,
    request: SceneRequest,
    run: Run,
    chosen: Steps,
) -> int:
    """Every fit in a run of its own, its steps cut to the time that is left, and the rest; fills `chosen`."""
    began = time.monotonic()
    configured = ConfiguredRequest(ask_for(request, expected.point), Selection()).pipeline
    order = configured.pipeline.order
    costs = {n: c for n, c in list_costs(expected.point, points).items() if n in order}
    planned: Steps = {n: p["steps"] for n, p in configured.parameters.items() if "steps" in p and n in costs}
    least = find_least_steps(points, planned)
    for fit in [*planned, None]:
        done = order[: order.index(fit)] if fit else list(order)
        if fit is not None and limits.seconds is not None:
            spent = time.monotonic() - began
            pace = learn_pace(pace, costs, spent, done)
            chosen[fit] = cut_steps(planned, costs, limits.seconds - spent, pace, done, least)[fit]
        elif fit is not None:
            chosen[fit] = planned[fit]
        further = [f"{n}.steps={s}" for n, s in chosen.items() if s != planned[n]]
        if code := run(ask_for(request, expected.point, further), Selection(until=fit), False):
            return code
    return 0


def describe_expectation(expected: Expectation, limits: Limits, pace: float) -> str:
    """What is said before anything of the budget is spent."""
    seconds, point = expected.seconds, expected.point
    told = f"like {point.name} of the study: PSNR {expected.psnr:.2f} dB there, {expected.memory_bytes / 2**20:.0f} MiB"
    if limits.seconds is not None and seconds > limits.seconds:
        told += f"; its {seconds:.0f} s do not fit, so that its steps are cut to {limits.seconds:.0f} s"
        seconds = limits.seconds
    if limits.psnr is not None and expected.psnr < limits.psnr:
        told += f"; no point within the limits reaches {limits.psnr:g} dB"
    return f"expects {seconds:.0f} s after the cameras, {told} (this machine takes {pace:.2f} s for a CPU second there)"


def _close(folder: Path, limits: Limits, expected: Expectation, steps: Steps, seconds: float, code: int) -> None:
    figures = read_figures(RunReport.model_validate(read_report(folder))) if code == 0 else {}
    told: dict[str, Any] = {
        "asked": dataclasses.asdict(limits),
        "expected": {"point": expected.point.name, "seconds": round(expected.seconds, 1), "psnr": expected.psnr},
        "actual": {"seconds": round(seconds, 1), "psnr": figures.get("psnr"), "exit_code": code},
        "steps": steps,
    }
    (folder / "budget.json").write_text(json.dumps(told, indent=2) + "\n")
    psnr = f", PSNR {figures['psnr']:.2f} dB" if "psnr" in figures else ""
    asked = f" of {limits.seconds:.0f} s" if limits.seconds is not None else ""
    _say(f"took {seconds:.0f} s{asked} ({expected.seconds:.0f} s expected){psnr} ({expected.psnr:.2f} dB expected)")


def _say(line: str) -> None:
    sys.stderr.write(f"budget: {line}\n")
