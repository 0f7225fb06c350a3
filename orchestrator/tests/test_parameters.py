"""Parameters are filled in, however deep, and what is wrong with them is said with the way out."""

import sys
from pathlib import Path
from types import ModuleType

import pytest
from orchestrator.tests.conftest import JoinConfig, write_toy

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.canonical import digest_of
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.parameters import combine_parameters, parse_overrides, resolve_parameters

WHOLE = {"levels": 8, "samples": [48], "weight": 1.0}


def joined(toy: Pipeline, *assignments: str, preset: str | None = None):
    return combine_parameters(toy, "join", preset, parse_overrides(toy, list(assignments)))


def test_defaults_are_filled_in_however_deep(toy):
    assert joined(toy) == {
        "steps": 10,
        "field": WHOLE,
        "limit": None,
        "estimator": {"name": "completed-views", "share": 0.4},
        "start": "initial-field",
    }
    assert joined(toy) == JoinConfig().model_dump(mode="json")


@pytest.mark.parametrize(
    "spelling",
    [
        ["join.field.levels=8"],
        ["join.field={samples: [48]}", "join.steps=10"],
        ["join.estimator=completed-views"],
        ["join.estimator={name: completed-views, share: 0.4}"],
        ["join.field.weight=1"],
        ["join.limit=null"],
    ],
)
def test_a_default_that_is_written_out_gives_the_same_key(toy, spelling):
    assert digest_of(joined(toy, *spelling)) == digest_of(joined(toy))


def test_groups_are_merged_parameter_by_parameter(toy):
    assert joined(toy, "join.field.levels=6", preset="fast")["field"] == {**WHOLE, "levels": 6, "samples": [16]}
    assert joined(toy, "join.estimator.guidance=2", preset="asked")["estimator"]["guidance"] == 2.0
    assert joined(toy, "join.estimator=sds", preset="asked")["estimator"]["guidance"] == 5.0
    assert joined(toy, "join.limit.levels=3")["limit"] == {**WHOLE, "levels": 3}


def test_a_group_of_another_kind_starts_from_its_own_defaults(toy):
    assert joined(toy, "join.estimator=nfsd", preset="asked")["estimator"] == {
        "name": "nfsd",
        "guidance": 8.0,
        "size": {**WHOLE, "levels": 2},
    }
    assert joined(toy, "join.estimator=completed-views", preset="asked") == joined(toy)
    assert joined(toy, "join.estimator=none")["estimator"] == {"name": "none"}


def test_the_order_of_settings_makes_no_difference_between_a_group_and_its_inside(toy):
    settings = ["join.estimator=sds", "join.estimator.guidance=2", "join.estimator.size.levels=9"]
    assert joined(toy, *settings) == joined(toy, *reversed(settings))
    assert joined(toy, *settings)["estimator"]["size"] == {**WHOLE, "levels": 9}


@pytest.mark.parametrize(
    ("assignment", "says"),
    [
        ("join.stepz=1", "join has no parameter stepz; did you mean steps?"),
        ("join.xyz=1", "join has no parameter xyz; it has estimator, field, limit, start, steps"),
        ("join.steps=many", "join.steps: 'many' is not of type 'integer'"),
        ("join.field.levels=many", "join.field.levels: 'many' is not of type 'integer'"),
        ("join.field.samples=[1, x]", "join.field.samples.1: 'x' is not of type 'integer'"),
        ("join.field.xyz=1", "join.field has no parameter xyz; it has levels, samples, weight"),
        ("join.field=3", "join.field: 3 is no group of parameters; set one of them, join.field.NAME=VALUE"),
        ("join.estimator=dds", "join.estimator: no estimator 'dds'; there are completed-views, sds, nfsd, none"),
        ("join.estimator.share=2", "join.estimator.share: 2.0 is greater than the maximum of 1"),
        (
            "join.estimator.guidance=2",
            "join.estimator.guidance: estimator completed-views has no parameter guidance; sds, nfsd take it: "
            "set join.estimator=sds",
        ),
        ("join.estimator.guidence=2", "join.estimator.guidence: estimator completed-views has no parameter guidence; "),
        ("join.guidance=2", "join has no parameter guidance; it is join.estimator.guidance (sds, nfsd take it)"),
        ("join.share=1", "join has no parameter share; it is join.estimator.share (completed-views takes it)"),
        ("join.weight=1", "it is join.field.weight, or join.limit.weight, or join.estimator.size.weight (sds, nfsd"),
    ],
)
def test_what_is_wrong_is_said_with_the_way_out(toy, assignment, says):
    with pytest.raises(ConfigurationError) as error:
        joined(toy, assignment)
    assert says in str(error.value)


def test_what_has_no_default_is_asked_for(toy):
    toy.path.parent.joinpath("schemas/parameters/train.json").write_text(
        '{"properties": {"steps": {"type": "integer"}}, "required": ["steps"]}'
    )
    with pytest.raises(ConfigurationError, match=r"train\.steps has no default; give it a value"):
        resolve_parameters(toy, "train", {})


def test_rules_that_join_parameters_are_those_of_the_stage(tmp_path: Path, monkeypatch):
    package, module = ModuleType("toy_join"), ModuleType("toy_join.config")
    module.__dict__["Config"] = JoinConfig
    monkeypatch.setitem(sys.modules, "toy_join", package)
    monkeypatch.setitem(sys.modules, "toy_join.config", module)
    toy = Pipeline(write_toy(tmp_path, join="toy_join"))
    assert joined(toy)["steps"] == 10
    with pytest.raises(ConfigurationError, match=r"^join: 9000 steps are too many for 8 levels; take fewer$"):
        joined(toy, "join.steps=9000")
