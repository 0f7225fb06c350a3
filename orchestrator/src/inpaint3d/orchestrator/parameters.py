"""Parameters by the published schema of each stage: defaults filled in, values checked before anything starts."""

import functools
import json
from pathlib import Path
from typing import Any, cast

import yaml
from jsonschema import Draft202012Validator, exceptions

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import Pipeline

SEED = "seed"


@functools.cache
def _schema(path: Path) -> dict[str, Any]:
    try:
        return cast(dict[str, Any], json.loads(path.read_text()))
    except FileNotFoundError as error:
        raise ConfigurationError(f"{path} is not there; run `make schemas`") from error


def parameter_schema(pipeline: Pipeline, node: str) -> dict[str, Any]:
    """The JSON Schema of a node's parameters."""
    name = pipeline.stages[node].metadata.name
    return _schema(pipeline.path.parent / "schemas" / "parameters" / f"{name}.json")


def resolved(pipeline: Pipeline, node: str, chosen: dict[str, Any]) -> dict[str, Any]:
    """The chosen parameters over the schema's defaults.

    Raises ConfigurationError naming the parameter, its value and what is allowed.
    """
    schema = parameter_schema(pipeline, node)
    known: dict[str, Any] = schema.get("properties", {})
    for name in chosen:
        if name not in known:
            raise ConfigurationError(f"{node} has no parameter {name}; it has {', '.join(sorted(known)) or 'none'}")
    # The schemas are generated, and a test holds them against the metaschema: that is not done again at every run.
    validator, best_match = cast(Any, Draft202012Validator(schema)), cast(Any, exceptions).best_match
    if (error := best_match(validator.iter_errors(chosen))) is not None:
        at = ".".join(str(p) for p in error.absolute_path) or "(parameters)"
        raise ConfigurationError(f"{node}.{at}: {error.message}")
    defaults = {name: entry["default"] for name, entry in known.items() if "default" in entry}
    return {**defaults, **chosen}


def parse_overrides(pipeline: Pipeline, assignments: list[str]) -> dict[str, dict[str, Any]]:
    """`STAGE.PARAM=VALUE` lines (the value is YAML) -> node -> parameter -> value. `STAGE.a.b=V` reaches inside.

    `STAGE.seed` is the node's seed: every stage has one.
    """
    overrides: dict[str, dict[str, Any]] = {}
    for line in assignments:
        target, equals, text = line.partition("=")
        node, dot, path = target.partition(".")
        if not equals or not dot or not path:
            raise ConfigurationError(f"--set {line}: write STAGE.PARAM=VALUE, e.g. joint-optimization.guidance=2")
        if node not in pipeline.nodes:
            raise ConfigurationError(f"--set {line}: no stage {node}; there are {', '.join(pipeline.order)}")
        try:
            value = yaml.safe_load(text)
        except yaml.YAMLError as error:
            raise ConfigurationError(f"--set {line}: {text!r} is not a YAML value") from error
        if path == SEED and (type(value) is not int or value < 0):
            raise ConfigurationError(f"--set {line}: a seed is a whole number, 0 or more")
        place = overrides.setdefault(node, {})
        *outer, last = path.split(".")
        for name in outer:
            place = cast(dict[str, Any], place.setdefault(name, {}))
        place[last] = value
    return overrides
