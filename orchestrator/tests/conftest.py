"""A pipeline of a few stages whose parameters have groups and kinds of groups, and ports that depend on them."""

import json
from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field, model_validator

from inpaint3d.contracts.models.base import Closed
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.schemas import build_schema


class Size(Closed):
    levels: int = 8
    samples: tuple[int, ...] = (48,)
    weight: float = 1.0


class Views(Closed):
    name: Literal["completed-views"] = "completed-views"
    share: float = Field(default=0.4, ge=0, le=1)


class Score(Closed):
    name: Literal["sds", "nfsd"] = "sds"
    guidance: float = 8.0
    size: Size = Size(levels=2)


class Nothing(Closed):
    name: Literal["none"]


ASKED = ["diffusers|prior"]


class JoinConfig(Closed):
    steps: int = 10
    field: Size = Size()
    limit: Size | None = None
    estimator: Annotated[Views | Score | Nothing, Field(discriminator="name")] = Field(
        default=Views(),
        json_schema_extra={"x-reads": {"completed-views": [], "none": [], "sds": ASKED, "nfsd": ASKED}},
    )
    start: Literal["initial-field", "fresh"] = Field(
        default="initial-field", json_schema_extra={"x-reads": {"initial-field": ["initial-field"], "fresh": []}}
    )

    @model_validator(mode="after")
    def _few(self) -> "JoinConfig":
        if self.steps > 1000 * self.field.levels:
            raise ValueError(f"{self.steps} steps are too many for {self.field.levels} levels; take fewer")
        return self


class TrainConfig(Closed):
    steps: int = 10


STAGES = {
    "ingest": ("{source: {schema: source@1}}", "{capture: {schema: capture@1.0}}"),
    "train": (
        "{capture: {schema: capture@1}, corpus: {schema: image-corpus@1, optional: true}}",
        "{prior: {schema: diffusion-prior@1.0}}",
    ),
    "join": (
        "{capture: {schema: capture@1}, prior: {schema: diffusion-prior@1, optional: true},"
        " diffusers: {schema: diffusers-pipeline@1, optional: true},"
        " initial-field: {schema: radiance-field@1, optional: true}}",
        "{radiance-field: {schema: radiance-field@1.1}}",
    ),
    "score": (
        "{fields: {schema: radiance-field@1, list: true, weak: true},"
        " prior: {schema: diffusion-prior@1, optional: true, weak: true}}",
        "{evaluation: {schema: evaluation@1.0}}",
    ),
}
PIPELINE = """
apiVersion: inpaint3d/v1
kind: Pipeline
metadata: {name: toy}
spec:
  externals:
    capture: {schema: source@1}
    corpus: {schema: image-corpus@1, optional: true}
    diffusers: {schema: diffusers-pipeline@1, optional: true}
  stages:
    - {name: ingest, stage: ingest, inputs: {source: external.capture}}
    - {name: train, stage: train, inputs: {capture: ingest.capture, corpus: external.corpus}}
    - {name: known, stage: join, inputs: {capture: ingest.capture}, parameters: {estimator: none}}
    - name: control
      stage: join
      inputs: {capture: ingest.capture, initial-field: known.radiance-field}
      parameters: {estimator: none}
    - name: join
      stage: join
      inputs:
        capture: ingest.capture
        prior: train.prior
        diffusers: external.diffusers
        initial-field: known.radiance-field
    - name: score
      stage: score
      inputs:
        fields: [join.radiance-field, control.radiance-field, known.radiance-field]
        prior: train.prior
  wants: [join, score]
  compare: [control]
  presets:
    plain: {}
    fast: {join: {field: {samples: [16], levels: 4}}}
    asked: {join: {estimator: {name: sds, guidance: 5}}}
"""


def write_toy(folder: Path, **packages: str) -> Path:
    """The toy's pipeline.yaml; packages: stage -> what its code is called, where it is not to be missing."""
    for name, (inputs, outputs) in STAGES.items():
        (folder / name).mkdir()
        (folder / name / "stage.yaml").write_text(
            f"{{apiVersion: inpaint3d/v1, kind: Stage, metadata: {{name: {name}, version: 0.1.0}}, spec: {{"
            f"description: toy, image: toy, module: {packages.get(name, f'toy.{name}')}, inputs: {inputs}, "
            f"outputs: {outputs}}}}}\n"
        )
    schemas = folder / "schemas" / "parameters"
    schemas.mkdir(parents=True)
    for name in STAGES:
        model = JoinConfig if name == "join" else TrainConfig
        (schemas / f"{name}.json").write_text(json.dumps(build_schema(model, name, "0")))
    (folder / "pipeline.yaml").write_text(PIPELINE)
    return folder / "pipeline.yaml"


@pytest.fixture
def toy(tmp_path: Path) -> Pipeline:
    return Pipeline(write_toy(tmp_path))
