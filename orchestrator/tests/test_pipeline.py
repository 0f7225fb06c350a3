"""pipeline.yaml is checked before anything runs; each message names the file, the line and the repair."""

from pathlib import Path

import pytest

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline

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


CHOSEN = (
    GOOD + "    - {name: c, stage: b, presets: [rich], seed: 1, inputs: {capture: a.capture}}\n"
    "    - {name: d, stage: d, inputs: {captures: [b.posed-capture, c.posed-capture]}}\n"
    "  presets: {rich: {c: {}}, plain: {}}\n"
)
READS_MANY = ("captures: {schema: posed-capture@1, list: true}", "capture: {schema: capture@1.0}")


def test_a_node_is_there_under_its_presets_alone(tmp_path):
    pipeline = Pipeline(write(tmp_path, CHOSEN, a=INGEST, b=POSES, d=READS_MANY))
    for preset in (None, "plain"):
        chosen = pipeline.under(preset)
        assert chosen.order == ["a", "b", "d"]
        assert chosen.references("d") == {"captures": ["b.posed-capture"]}
        assert chosen.upstream("d") == {"b"}
    rich = pipeline.under("rich")
    assert set(rich.order) == {"a", "b", "c", "d"}
    assert rich.upstream("d") == {"b", "c"}
    assert rich.nodes["c"].seed == 1


def test_what_a_node_needs_is_there_under_all_its_presets(tmp_path):
    nodes = CHOSEN.replace("[b.posed-capture, c.posed-capture]", "c.posed-capture")
    reads_one = ("captures: {schema: posed-capture@1}", READS_MANY[1])
    with pytest.raises(ConfigurationError, match=r"c\.posed-capture: preset \(none\) has d, but not c"):
        Pipeline(write(tmp_path, nodes, a=INGEST, b=POSES, d=reads_one))


def test_a_node_of_a_preset_that_is_not_there(tmp_path):
    with pytest.raises(ConfigurationError, match=r":9: c: no preset poor"):
        Pipeline(write(tmp_path, CHOSEN.replace("[rich]", "[poor]"), a=INGEST, b=POSES, d=READS_MANY))


def test_unknown_preset_lists_those_there_are(tmp_path):
    pipeline = Pipeline(write(tmp_path, GOOD + "  presets: {quick: {a: {}}}\n", a=INGEST, b=POSES))
    assert pipeline.parameters("a", "quick") == {}
    with pytest.raises(ConfigurationError, match="no preset slow .*quick".replace("slow", "'slow'")):
        pipeline.parameters("a", "slow")
