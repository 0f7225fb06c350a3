"""What a study varies: `study.yaml` beside the pipeline, and what a drawn point asks of a run."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from inpaint3d.contracts.models.base import Closed, Finite
from inpaint3d.contracts.models.documents import load_document
from inpaint3d.contracts.models.pipeline import Parameters

Value = bool | int | Finite | str
Drawn = Mapping[str, Value]
"""Knob -> value."""


class Knob(Closed):
    """One thing that is varied: a list to choose from, or a range of whole numbers. Several parameters may share it."""

    sets: Annotated[tuple[str, ...], Field(min_length=1)] = Field(description="STAGE.PARAM, as `--set` names it")
    choices: tuple[Value, ...] = Field(default=(), description="in order; the cheapest first")
    low: int | None = None
    high: int | None = None
    log: bool = Field(default=False, description="spread evenly over orders of magnitude")

    @model_validator(mode="after")
    def _check_extent(self) -> "Knob":
        spans = self.low is not None and self.high is not None and 0 < self.low < self.high
        if bool(self.choices) == spans or len(self.choices) == 1:
            raise ValueError("a knob has two choices or more, or low and high with 0 < low < high")
        return self


class StudySpec(Closed):
    """How the points of a study are chosen and measured."""

    preset: str = Field(default="standard", description="what a knob that is not drawn stands at")
    presets: tuple[str, ...] = Field(default=(), description="measured first, as they are")
    until: str = Field(default="evaluation", description="the last stage that a point runs")
    judge: str = Field(
        description="stage after which a point may end early: it cost no less than a finished one, and is worse by "
        "`margin_db` there",
    )
    margin_db: Finite = 0.5
    fixed: dict[str, Parameters] = Field(default={}, description="node -> parameters, alike for every point")
    knobs: Annotated[dict[str, Knob], Field(min_length=1)]


class StudyMetadata(Closed):
    name: str


class StudyDocument(Closed):
    """A `study.yaml`."""

    apiVersion: Literal["inpaint3d/v1"]  # noqa: N815
    kind: Literal["Study"]
    metadata: StudyMetadata
    spec: StudySpec


def load_study(path: Path) -> StudySpec:
    """The study that a file describes. Raises ConfigurationError naming file, line and field."""
    return load_document(path, StudyDocument)[0].spec


def list_assignments(spec: StudySpec, drawn: Drawn) -> list[str]:
    """STAGE.PARAM=VALUE of everything that a point sets, as `--set` takes it."""
    fixed = [
        f"{node}.{name}={write_value(value)}" for node, values in spec.fixed.items() for name, value in values.items()
    ]
    chosen = [f"{target}={write_value(drawn[name])}" for name, knob in spec.knobs.items() if name in drawn
              for target in knob.sets]  # fmt: skip
    return fixed + chosen


def write_value(value: Any) -> str:
    """A value as YAML, and so `--set`, spells it."""
    return str(value).lower() if isinstance(value, bool) else str(value)
