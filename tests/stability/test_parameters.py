"""Parameters that no formula can take: refused before any work, by their names."""

import importlib
import math
import pkgutil
import re
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

import pytest
from pydantic import BaseModel, ValidationError

from inpaint3d import stages
from tests.stability.catalogue import hard_case

PARAMETERS = "Parameters"
Given = dict[str, Any]


def set_each(model: type[BaseModel], value: float) -> Iterator[tuple[str, Given]]:
    """Every parameter that takes a number that is not whole, groups and alternatives included, set to a value."""
    names = {name: field.annotation for name, field in model.model_fields.items()}
    # What an alternative is told by.
    tags = {name: get_args(kind)[0] for name, kind in names.items() if get_origin(kind) is Literal}
    for name, annotation in names.items():
        kinds = [annotation, *get_args(annotation)]
        if any(kind is float or float in get_args(kind) for kind in kinds):
            yield name, {**tags, name: value}
        for kind in kinds:
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                for below, given in set_each(kind, value):
                    yield f"{name}.{below}", {**tags, name: given}


CONFIGS: dict[str, type[BaseModel]] = {
    module.name: importlib.import_module(f"inpaint3d.stages.{module.name}.config").Config
    for module in pkgutil.iter_modules(stages.__path__)
}


def list_taken(value: float) -> tuple[list[str], list[str]]:
    """STAGE.PARAMETER of all parameters, and of those that take the value."""
    every, taken = [], []
    for stage, config in CONFIGS.items():
        for path, given in set_each(config, value):
            every.append(f"{stage}.{path}")
            try:
                config.model_validate(given)
            except ValidationError as error:
                told = [e["loc"] for e in error.errors()]
                if any(path.rpartition(".")[2] in loc for loc in told):
                    continue
            taken.append(every[-1])
    return every, taken


@hard_case(
    PARAMETERS,
    plain="a weight of NaN makes every loss NaN; what float32 does not hold `cannot be converted to type float`",
    ours="bounded where float32 still holds what is made of it",
    swept="NaN, inf and -inf in every parameter of every stage; 1e39 and 1e300 in those of fits",
    told="the parameter's name, the value and the bound (exit code 2)",
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_parameters_are_finite(value: float) -> None:
    every, taken = list_taken(value)
    assert len(every) > 120
    assert taken == []


@pytest.mark.parametrize("value", [1e39, 1e300])
def test_parameters_of_fits_are_numbers_of_float32(value: float) -> None:
    every, taken = list_taken(value)
    fits = re.compile(r"\.(loss_weights|optimizer|architecture|estimator|learning_rate|fine_tuning_rate|enlarged)\b")
    assert len([path for path in every if fits.search(path)]) > 50
    assert [path for path in taken if fits.search(path)] == []
