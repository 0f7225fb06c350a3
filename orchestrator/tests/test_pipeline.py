"""pipeline.yaml is checked before anything runs; each message names the file, the line and the repair."""

from pathlib import Path

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.pipeline import Pipeline

STAGE = """
apiVersion: inpaint3d/v1
kind: Stage
metadata: {{name: {name}, version: 0.1.0}}
spec:
  description: toy
  image: toy
  module: toy.{name}
  inputs: {{{inputs}}}
  outputs: {{{outputs}}}
"""
HEAD = """apiVersion: inpaint3d/v1
kind: Pipeline
metadata: {name: toy}
spec:
  externals: {capture: {schema: source@1}}
  stages:
"""


def write(folder: Path, nodes: str, **stages: tuple[str, str]) -> Path:
    for name, (inputs, outputs) in stages.items():
        (folder / name).mkdir()
        (folder / name / "stage.yaml").write_text(STAGE.format(name=name, inputs=inputs, outputs=outputs))
    path = folder / "pipeline.yaml"
    path.write_text(HEAD + nodes)
    return path


INGEST = ("source: {schema: source@1}", "capture: {schema: capture@1.0}, truth: {schema: truth@1.0, optional: true}")
POSES = ("capture: {schema: capture@1}", "posed-capture: {schema: posed-capture@1.0}")
GOOD = (
    "    - {name: a, stage: a, inputs: {source: external.capture}}\n"
    "    - {name: b, stage: b, inputs: {capture: a.capture}}\n"
)


def test_order_up_and_downstream(tmp_path):
    pipeline = Pipeline(write(tmp_path, GOOD, a=INGEST, b=POSES))
    assert pipeline.order == ["a", "b"]
    assert pipeline.upstream("b") == {"a"}
    assert pipeline.downstream("a") == {"b"}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("a.capture", "a.captures", r":8: a\.captures: a has no output captures; it has capture, truth"),
        ("a.capture", "c.capture", r":8: c\.capture: no node c; there are a, b"),
        ("{capture: a.capture}", "{frames: a.capture}", r":8: b has no input frames; it has capture"),
        ("{capture: a.capture}", "{capture: a.truth}", r":8: a\.truth is truth@1\.0, but b\.capture takes capture@1"),
        ("{capture: a.capture}", "{capture: [a.capture]}", r":8: b\.capture takes one reference"),
        ("{capture: a.capture}", "{}", r":8: b: its input capture is not wired"),
        ("external.capture", "external.photos", r":7: external\.photos: no external photos"),
        ("name: b", "name: a", r":8: a second node is called a"),
        ("stage: b", "stage: z", r":8: b: there is no .*z/stage\.yaml"),
        ("inputs: {source", "input: {source", r":7: spec\.stages\.0\.input: Extra inputs are not permitted"),
    ],
)
def test_mistakes_are_named_with_their_line(tmp_path, old, new, says):
    assert old in GOOD
    with pytest.raises(ConfigurationError, match=says):
        Pipeline(write(tmp_path, GOOD.replace(old, new), a=INGEST, b=POSES))


def test_a_circle_is_shown(tmp_path):
    loop = ("capture: {schema: capture@1}", "capture: {schema: capture@1.0}")
    nodes = (
        "    - {name: a, stage: a, inputs: {capture: b.capture}}\n"
        "    - {name: b, stage: b, inputs: {capture: a.capture}}\n"
    )
    with pytest.raises(ConfigurationError, match=r"circle: (a -> b -> a|b -> a -> b)"):
        Pipeline(write(tmp_path, nodes, a=loop, b=loop))


def test_incompatible_schema_majors_are_found_when_the_plan_is_made(tmp_path):
    newer = ("capture: {schema: capture@2}", POSES[1])
    with pytest.raises(ConfigurationError, match=r"a\.capture is capture@1\.0, but b\.capture takes capture@2"):
        Pipeline(write(tmp_path, GOOD, a=INGEST, b=newer))


def test_unknown_preset_lists_those_there_are(tmp_path):
    pipeline = Pipeline(write(tmp_path, GOOD + "  presets: {quick: {a: {}}}\n", a=INGEST, b=POSES))
    assert pipeline.parameters("a", "quick") == {}
    with pytest.raises(ConfigurationError, match="no preset slow .*quick".replace("slow", "'slow'")):
        pipeline.parameters("a", "slow")
