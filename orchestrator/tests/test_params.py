"""`inpaint3d params` and the options of the program itself."""

import json

import pytest
from typer.testing import CliRunner

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.orchestrator.cli import add_other_commands

PROGRAM = add_other_commands()


def list_params(toy: Pipeline, *arguments: str) -> dict[tuple[str, str], dict[str, object]]:
    line = ["params", *arguments, "--pipeline", str(toy.path), "--json"]
    answer = CliRunner().invoke(PROGRAM, line, catch_exceptions=False)
    return {(row["path"], row["kind"]): row for row in json.loads(answer.stdout)}


def test_parameters_are_listed_with_what_they_may_be_and_their_defaults(toy):
    rows = list_params(toy, "join")
    assert rows["steps", ""]["default"] == 10
    assert rows["start", ""]["values"] == "initial-field | fresh"
    assert rows["field.levels", ""]["default"] == 8
    assert rows["estimator.name", ""]["values"] == "completed-views | sds | nfsd | none"
    assert rows["estimator.share", "completed-views"]["values"] == "number, ≥ 0, ≤ 1"
    assert rows["estimator.guidance", "sds | nfsd"]["default"] == 8.0
    assert "or null" in str(rows["limit", ""]["values"])


def test_a_preset_s_values_are_what_it_says(toy):
    rows = list_params(toy, "join", "--preset", "asked")
    assert rows["estimator.name", ""]["default"] == "sds"
    assert rows["estimator.guidance", "sds | nfsd"]["default"] == 5
    assert list_params(toy, "join", "--preset", "fast")["field.levels", ""]["default"] == 4


def test_what_there_is_not_is_refused_with_what_there_is(toy):
    with pytest.raises(ConfigurationError, match=r"no stage joint .* ingest, train"):
        list_params(toy, "joint")
    with pytest.raises(ConfigurationError, match="no preset 'slow'"):
        list_params(toy, "join", "--preset", "slow")


@pytest.mark.parametrize(("option", "said"), [("--version", "inpaint3d 0."), ("-h", "params"), ("--help", "params")])
def test_the_program_says_what_it_is(option, said):
    answer = CliRunner().invoke(PROGRAM, [option])
    assert answer.exit_code == 0
    assert said in answer.stdout
