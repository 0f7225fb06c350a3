from dataclasses import dataclass
from typing import Annotated

import typer
from typer.testing import CliRunner

from inpaint3d.orchestrator.options import with_options


@dataclass(frozen=True)
class Base:
    seed: Annotated[int, typer.Option(help="a seed")] = 0
    depth: int = 7


@dataclass(frozen=True)
class Deep(Base):
    depth: Annotated[int, typer.Option("--deep")] = 7


def invoke(group, *line):
    said = []

    def command(place: Annotated[str, typer.Argument()], group: group, loud: bool = False) -> None:  # pyright: ignore
        """Say it."""
        said.append((place, group, loud))

    command.__annotations__["group"] = group
    app = typer.Typer()
    app.command()(with_options(command))
    return CliRunner().invoke(app, list(line)), said


def test_fields_become_options_and_come_back_as_one_object():
    result, said = invoke(Base, "here", "--seed", "3", "--loud")
    assert result.exit_code == 0, result.output
    assert said == [("here", Base(seed=3), True)]
    assert invoke(Base, "here")[1] == [("here", Base(), False)]


def test_a_field_whose_type_is_bare_is_no_option():
    assert invoke(Base, "here", "--depth", "2")[0].exit_code == 2
    assert invoke(Deep, "here", "--deep", "2")[1] == [("here", Deep(depth=2), False)]


def test_help_is_that_of_the_command_and_of_each_field():
    text = invoke(Base, "--help")[0].output
    assert "Say it." in text
    assert "a seed" in text
