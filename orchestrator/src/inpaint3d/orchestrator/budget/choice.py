"""Which point of a study fits a budget on this machine, and how far its steps have to be cut."""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.orchestrator.study.points import AFTER, Point
from inpaint3d.orchestrator.study.sweep import PROBED

SPARE = 0.1
"""Share of a time budget that is not planned with: runs of one key differ by as much."""
LEAST_STEPS = 50
SECONDS = {"s": 1, "m": 60, "h": 3600}
BYTES = {"M": 2**20, "G": 2**30}
Steps = dict[str, int]
"""Node -> optimisation steps."""


@dataclass(frozen=True)
class Limits:
    """What was asked: seconds after the cameras, bytes of any stage, dB."""

    seconds: float | None = None
    memory_bytes: int | None = None
    psnr: float | None = None


@dataclass(frozen=True)
class Expectation:
    """What a run under a point is expected to take and to reach."""

    point: Point
    seconds: float
    psnr: float
    memory_bytes: int


def read_limits(time: str | None, memory: str | None, psnr: float | None) -> Limits:
    """The options' values; ConfigurationError for one that is none."""
    seconds = None if time is None else _read_quantity("--time-budget", time, SECONDS, "90s, 5m or 1h")
    size = None if memory is None else int(_read_quantity("--memory-budget", memory, BYTES, "800M or 4G"))
    return Limits(seconds, size, psnr)


def _read_quantity(option: str, text: str, units: Mapping[str, int], examples: str) -> float:
    parts = re.fullmatch(r"(\d+(?:\.\d+)?)(\w)", text.strip())
    if parts is None or parts[2] not in units or float(parts[1]) == 0:
        raise ConfigurationError(f"{option} {text}: not understood; write {examples}")
    return float(parts[1]) * units[parts[2]]


@dataclass(frozen=True)
class Cost:
    """CPU seconds of a stage: what grows with its steps, and the rest."""

    steps_s: float
    rest_s: float

    @property
    def seconds(self) -> float:
        return self.steps_s + self.rest_s


Costs = Mapping[str, Cost]


def list_costs(point: Point, everywhere: Sequence[Point]) -> Costs:
    """Of each stage after the cameras, in the pipeline's order; of one that the point did not run, the most of any."""
    nodes = dict.fromkeys(n for p in everywhere for n in p.stages if n not in AFTER)
    found = {
        n: point.stages.get(n) or max((p.stages[n] for p in everywhere if n in p.stages), key=lambda c: c.cpu_s)
        for n in nodes
    }
    return {n: Cost(c.steps_cpu_s or 0.0, c.cpu_s - (c.steps_cpu_s or 0.0)) for n, c in found.items()}


def choose_point(points: Sequence[Point], limits: Limits, pace: float) -> Expectation:
    """The most accurate point within the limits, or with a target the cheapest that reaches it.

    pace: seconds here for a CPU second of the study. Where every point takes too long, the shortest is taken and its
    steps are cut. Raises ConfigurationError where none fits the memory.
    """
    fitting = [p for p in points if limits.memory_bytes is None or p.peak_memory_bytes <= limits.memory_bytes]
    if not fitting:
        least = min(p.peak_memory_bytes for p in points)
        raise ConfigurationError(f"--memory-budget: no point of the study fits; give {least / 2**20:.0f}M or more")
    expected = [
        Expectation(p, pace * _sum_seconds(list_costs(p, points)), p.figures["psnr"], p.peak_memory_bytes)
        for p in fitting
    ]
    within = [e for e in expected if limits.seconds is None or e.seconds <= limits.seconds * (1 - SPARE)]
    if limits.psnr is not None and (reaching := [e for e in within if e.psnr >= limits.psnr]):
        return min(reaching, key=lambda e: e.seconds)
    if within:
        return max(within, key=lambda e: (e.psnr, -e.seconds))
    return min(expected, key=lambda e: e.seconds)


def _sum_seconds(costs: Costs) -> float:
    return sum(c.seconds for c in costs.values())


def learn_pace(pace: float, costs: Costs, spent: float, done: Collection[str]) -> float:
    """The pace once some stages are `done` in `spent` seconds: never faster, since their results may have been kept."""
    planned = _sum_seconds({n: c for n, c in costs.items() if n in done})
    return max(pace, spent / planned) if planned else pace


def find_least_steps(points: Sequence[Point], steps: Steps) -> Steps:
    """The steps that a fit is never cut below: 50, the first fit the fewest that a point was measured with.

    Masks are made of the first one: too poor a field ends the run, where a short fit later on only looks worse.
    """
    asked = [dict(a.split("=", 1) for a in p.assignments) for p in points]
    measured = [int(a[name]) for a in asked if (name := f"{PROBED}.steps") in a]
    least = {n: min(LEAST_STEPS, s) for n, s in steps.items()}
    return least | ({PROBED: min(*measured, steps[PROBED])} if PROBED in steps and measured else {})


def cut_steps(
    steps: Steps, costs: Costs, seconds: float, pace: float, done: Collection[str], least: Steps | None = None
) -> Steps:
    """The steps that the time leaves the fits that are still to run: all cut by the same share, none below `least`.

    seconds: what is left of the budget. `done` stages cost nothing more. A budget that does not pay for the least steps
    (50 where nothing is said) is overrun.
    """
    left = {n: c for n, c in costs.items() if n not in done}
    floors = {n: min(LEAST_STEPS, s) for n, s in steps.items()} | (least or {})
    chosen = {n: steps[n] for n in steps if n in left}
    free = set(chosen)
    spare = seconds * (1 - SPARE / 2) - pace * sum(c.rest_s if n in chosen else c.seconds for n, c in left.items())
    while free:
        planned = pace * sum(left[n].steps_s for n in free)
        share = min(1.0, spare / planned) if planned else 1.0
        held = {n for n in free if steps[n] * share < floors[n]}
        chosen |= {n: floors[n] if n in held else int(steps[n] * share) for n in free}
        if not held:
            break
        free -= held
        spare -= pace * sum(left[n].steps_s * floors[n] / steps[n] for n in held)
    return chosen
