"""Points of a study: what each was asked, what it cost, how it scored; and which of them nothing beats."""

import json
import shlex
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.base import Closed, Finite
from inpaint3d.contracts.models.report import Machine
from inpaint3d.orchestrator.study.space import Value

AFTER = ("capture-ingest", "pose-estimation")
"""Stages before the whole pipeline's clock starts: every setting needs the cameras, and most share them."""


class StageCost(Closed):
    """What a stage took in the run that computed its result, and how the field that it made shows held-out photos."""

    wall_s: Finite
    cpu_s: Finite
    peak_memory_bytes: int
    held_out_psnr: Finite | None = None
    steps_cpu_s: Finite | None = Field(default=None, description="of cpu_s, up to the last score of a fit")


class Point(Closed):
    """One setting of the pipeline, measured.

    figures: metric -> mean, of the result under the study's protocol; empty where the point ended early.
    """

    name: str
    state: Literal["done", "stopped-early", "failed"]
    preset: str
    knobs: dict[str, Value] = {}
    command: str
    stages: dict[str, StageCost] = {}
    figures: dict[str, Finite] = {}
    error: str | None = None

    def sum_seconds(self, kind: Literal["wall_s", "cpu_s"] = "cpu_s", until: str | None = None) -> float:
        """Seconds of the stages after the cameras, in the pipeline's order, up to one of them; evaluation not counted.

        Evaluation judges the result; who wants the result alone does not wait for it.
        """
        total = 0.0
        for node, cost in self.stages.items():
            total += getattr(cost, kind) if node not in (*AFTER, "evaluation") else 0.0
            if node == until:
                break
        return total

    @property
    def assignments(self) -> list[str]:
        """What the command sets."""
        words = shlex.split(self.command)
        return [value for option, value in pairwise(words) if option == "--set"]

    @property
    def camera_settings(self) -> tuple[str, ...]:
        """What decides the cameras and frames; held-out pixels of others are other pixels."""
        own = tuple(a for a in self.assignments if a.split(".")[0] in AFTER)
        return own if self.knobs else (*own, f"preset {self.preset}")

    @property
    def peak_memory_bytes(self) -> int:
        """The most that any stage held at once, those before the cameras and evaluation included."""
        return max(cost.peak_memory_bytes for cost in self.stages.values())


class StudyResults(Closed):
    """`points.json`: all points of a study on one machine and one capture."""

    capture: str
    protocol: str | None = None
    machine: Machine | None = None
    probe_cpu_s: Finite | None = Field(
        default=None, description="of the probe's fit, by which another machine and capture are compared with these"
    )
    points: tuple[Point, ...] = ()

    @property
    def measured(self) -> list[Point]:
        """The points that ran to their end."""
        return [p for p in self.points if p.state == "done" and p.figures]

    def with_point(self, point: Point) -> "StudyResults":
        """The results with a point added, or measured anew."""
        asked = (point.preset, point.knobs)
        others = tuple(p for p in self.points if p.name != point.name and (p.preset, p.knobs) != asked)
        return self.model_copy(update={"points": (*others, point)})

    def write(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        staged = path.with_name(f".{path.name}.new")
        staged.write_text(self.model_dump_json(indent=1, exclude_none=True) + "\n")
        staged.replace(path)


def read_results(path: Path) -> StudyResults:
    """Raises BadInputError where the file is no study's results."""
    try:
        return StudyResults.model_validate(json.loads(path.read_text()))
    except (OSError, ValueError, ValidationError) as error:
        raise BadInputError(f"{path} holds no results of a study ({error}); run `inpaint3d study` anew") from error


def find_front(points: Sequence[Point], cost: Callable[[Point], float], gain: Callable[[Point], float]) -> list[Point]:
    """The Pareto front, cheapest first: no other point costs at most as much and gains at least as much.

    Of equal points the first in the order given stays.
    """
    front: list[Point] = []
    for point in sorted(points, key=lambda p: (cost(p), -gain(p))):
        if not front or gain(point) > gain(front[-1]):
            front.append(point)
    return front


def is_beaten(point: Point, others: Sequence[Point], stage: str, margin_db: float) -> bool:
    """Whether up to a stage a finished point of the same frames took no longer and is better by the margin."""
    reached = point.stages[stage].held_out_psnr if stage in point.stages else None
    if reached is None:
        return False
    spent = point.sum_seconds(until=stage)
    return any(
        (other.stages[stage].held_out_psnr or 0.0) >= reached + margin_db
        for other in others
        if stage in other.stages
        and other.camera_settings == point.camera_settings
        and other.sum_seconds(until=stage) <= spent
    )
