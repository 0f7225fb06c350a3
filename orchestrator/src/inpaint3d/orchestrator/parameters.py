"""Parameters by each stage's published schema: defaults filled in, values checked before anything starts."""

import difflib
import importlib
import json
from collections.abc import Iterator
from typing import Any, cast

from pydantic import BaseModel, ValidationError

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import VARIANT, Parameters, Pipeline, merge_parameters
from inpaint3d.contracts.models.stage import StageSpec
from inpaint3d.contracts.models.untrusted import UntrustedError, parse_yaml
from inpaint3d.orchestrator.parameter_schema import Place, parameter_schema

SEED = "seed"
Overrides = dict[str, Parameters]
"""Node -> parameter -> value; `seed`, which is no parameter of any stage, is the node's seed."""


def combine_parameters(pipeline: Pipeline, node: str, preset: str | None, overrides: Overrides) -> Parameters:
    """A node's parameters: the stage's defaults, pipeline.yaml's over them, the preset's, the command line's."""
    chosen = {name: value for name, value in overrides.get(node, {}).items() if name != SEED}
    written = pipeline.parameters(node, preset, parameter_schema(pipeline, node).defaults)
    return resolve_parameters(pipeline, node, merge_parameters(written, chosen))


def resolve_parameters(pipeline: Pipeline, node: str, chosen: Parameters) -> Parameters:
    """The chosen parameters with every default filled in, however deep.

    Raises ConfigurationError naming the parameter, its value and what is allowed.
    """
    schema = parameter_schema(pipeline, node)
    whole = fill_defaults(schema, chosen)
    config = _find_config(pipeline.stages[node])
    if config is None or not _is_valid(config, whole):
        for problem in _find_problems(schema, schema, whole, node, node):
            raise ConfigurationError(problem)
    if config is not None:
        _check_with_config(config, node, whole)
    return whole


def fill_defaults(place: Place, value: Any) -> Any:
    """A value with the defaults of its groups; a group's bare kind spelled out; whole numbers as the schema has them.

    One value has one spelling, so that it has one key.
    """
    if place.kinds and isinstance(value, str):
        value = {VARIANT: value}
    if isinstance(value, dict) and place.is_group:
        given = cast(Parameters, value)
        if (group := place.group_of(given)) is None:
            return given
        merged = cast(Parameters, merge_parameters(group.defaults | _take_kind(given), given))
        return {n: fill_defaults(group.properties[n], v) if n in group.properties else v for n, v in merged.items()}
    if isinstance(value, list) and (items := place.items) is not None:
        return [fill_defaults(items, item) for item in cast(list[Any], value)]
    return _fill_number(place, value)


def _fill_number(place: Place, value: Any) -> Any:
    return float(value) if type(value) is int and place.schema.get("type") == "number" else value


def _take_kind(given: Parameters) -> Parameters:
    return {VARIANT: given[VARIANT]} if VARIANT in given else {}


def _find_problems(whole: Place, place: Place, value: Any, at: str, node: str) -> Iterator[str]:
    """What is wrong with a value, each with its place; a group of several kinds is held against its own kind alone."""
    if not place.is_group or (value is None and place.nullable):
        from jsonschema import Draft202012Validator, exceptions  # a sixth of a second, for what is wrong alone

        # The schemas are generated, and a test holds them against the metaschema: that is not done again at every run.
        validator = cast(Any, Draft202012Validator({**place.written, "$defs": place.root.get("$defs", {})}))
        if (error := cast(Any, exceptions).best_match(validator.iter_errors(value))) is not None:
            yield ".".join([at, *map(str, error.absolute_path)]) + f": {error.message}"
        return
    if not isinstance(value, dict):
        yield f"{at}: {value!r} is no group of parameters; set one of them, {at}.NAME=VALUE"
        return
    given = cast(Parameters, value)
    group = place.group_of(given)
    if group is None:
        yield f"{at}: no {_take_last(at)} {given.get(VARIANT)!r}; there are {', '.join(place.kinds)}"
        return
    for name in given:
        if name not in group.properties:
            yield _explain_unknown(whole, place, group, given, at, name, node)
    yield from (f"{at}.{name} has no default; give it a value" for name in group.required if name not in given)
    for name, inner in group.properties.items():
        if name in given:
            yield from _find_problems(whole, inner, given[name], f"{at}.{name}", node)


def _explain_unknown(whole: Place, place: Place, group: Place, given: Parameters, at: str, name: str, node: str) -> str:
    """That there is no such parameter here, and where there is one."""
    what = f"{at} has no parameter {name}"
    if place.kinds:
        what = f"{at}.{name}: {_take_last(at)} {given[VARIANT]} has no parameter {name}"
        if takers := [kind for kind, other in place.kinds.items() if name in other.properties]:
            return f"{what}; {_say_takers(takers)}: set {at}={takers[0]}"
    elsewhere: dict[str, list[str]] = {}
    for path, kind in whole.find(name, node):
        elsewhere.setdefault(path, []).extend([kind] if kind else [])
    if elsewhere:
        hints = [f"{path} ({_say_takers(kinds)})" if kinds else path for path, kinds in elsewhere.items()]
        return f"{what}; it is {', or '.join(hints)}"
    if near := difflib.get_close_matches(name, group.properties):
        return f"{what}; did you mean {' or '.join(near)}?"
    return f"{what}; it has {', '.join(sorted(group.properties)) or 'none'}"


def _say_takers(kinds: list[str]) -> str:
    return f"{', '.join(kinds)} {'takes' if len(kinds) == 1 else 'take'} it"


def _take_last(at: str) -> str:
    return at.rpartition(".")[2]


def _find_config(stage: StageSpec) -> type[BaseModel] | None:
    """The stage's own `Config`, whose rules join parameters; None where the stage isn't installed."""
    name = f"{stage.spec.module}.config"
    try:
        return importlib.import_module(name).Config
    except ModuleNotFoundError as error:
        if error.name is None or not f"{name}.".startswith(f"{error.name}."):
            raise
        return None


def _is_valid(config: type[BaseModel], parameters: Parameters) -> bool:
    """Whether the stage takes the parameters as they are, converting nothing: then its schema, made of it, does too."""
    try:
        config.model_validate_json(json.dumps(parameters), strict=True)
    except (ValidationError, TypeError):
        return False
    return True


def _check_with_config(config: type[BaseModel], node: str, parameters: Parameters) -> None:
    try:
        config.model_validate(parameters)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        at = ".".join([node, *map(str, first["loc"])])
        raise ConfigurationError(f"{at}: {first['msg'].removeprefix('Value error, ')}") from error


def parse_overrides(pipeline: Pipeline, assignments: list[str]) -> Overrides:
    """`STAGE.PARAM=VALUE` lines (the value is YAML) -> node -> parameter -> value. `STAGE.a.b=V` reaches inside.

    `STAGE.seed` is the node's seed: every stage has one. Which line comes first makes no difference between a group
    and what is inside it.
    """
    overrides: Overrides = {}
    for line in sorted(assignments, key=lambda line: line.partition("=")[0].count(".")):
        node, path, value = _parse_assignment(pipeline, line)
        for name in reversed(path):
            value = {name: value}
        overrides[node] = merge_parameters(overrides.get(node, {}), value)
    return overrides


def _parse_assignment(pipeline: Pipeline, line: str) -> tuple[str, list[str], Any]:
    """(node, path, value) of a `--set`. Raises ConfigurationError naming it."""
    target, equals, text = line.partition("=")
    node, *path = target.split(".")
    if not equals or not path or not all(path):
        raise ConfigurationError(f"--set {line}: write STAGE.PARAM=VALUE, e.g. masked-reconstruction.steps=800")
    if node not in pipeline.nodes:
        raise ConfigurationError(f"--set {line}: no stage {node}; there are {', '.join(pipeline.order)}")
    try:
        value, _ = parse_yaml(text)
    except UntrustedError as error:
        raise ConfigurationError(f"--set {line}: {text!r:.200} is not a YAML value ({error})") from error
    if path == [SEED] and (type(value) is not int or value < 0):
        raise ConfigurationError(f"--set {line}: a seed is a whole number, 0 or more")
    return node, path, value
