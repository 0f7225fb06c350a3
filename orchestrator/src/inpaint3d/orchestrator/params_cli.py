"""`inpaint3d params`: what a stage can be told, with units, as its own configuration says."""

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Annotated, Any, cast

import typer

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import VARIANT, Pipeline
from inpaint3d.orchestrator.options import AsJson, PipelinePath, Preset
from inpaint3d.orchestrator.parameter_schema import Place, parameter_schema
from inpaint3d.orchestrator.parameters import combine_parameters
from inpaint3d.orchestrator.plan import find_pipeline
from inpaint3d.orchestrator.tables import print_table

RANGES = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


@dataclass(frozen=True)
class Parameter:
    """As `--set STAGE.path=VALUE` takes it. `kind`: of the groups around it, where they have several."""

    path: str
    kind: str
    values: str
    default: Any
    description: str


def add_to(app: typer.Typer) -> None:
    """Make the command part of `inpaint3d`."""
    app.command()(params)


def params(
    stage: Annotated[str, typer.Argument(help="a stage of the pipeline")],
    preset: Preset = None,
    pipeline: PipelinePath = None,
    as_json: AsJson = False,
) -> None:
    """List a stage's parameters: values, default under the preset, what each is, with its unit."""
    found = Pipeline(find_pipeline(pipeline))
    if stage not in found.order:
        raise ConfigurationError(f"no stage {stage} in {found.path}; there are {', '.join(found.order)}")
    told = combine_parameters(found, stage, preset or found.spec.spec.defaultPreset, {})
    rows = list(list_parameters(parameter_schema(found, stage), told))
    if as_json:
        sys.stdout.write(json.dumps([asdict(row) for row in rows], indent=2) + "\n")
        return
    columns = ("parameter", "with", "values", "default", "what it is")
    cells = [(r.path, r.kind, r.values, _write(r.default), r.description) for r in rows]
    print_table(columns, cells, wrapped=("values", "what it is"))


def list_parameters(place: Place, told: Mapping[str, Any], at: str = "", kind: str = "") -> Iterator[Parameter]:
    """Every parameter below a group, in the stage's own order; `told`: what the group says under a preset, complete.

    Of a group of several kinds the parameters of all; their defaults are those of the kind that the preset has, and
    each other kind's own.
    """
    if place.kinds:
        description = place.schema.get("description", "")
        yield Parameter(f"{at}{VARIANT}", kind, " | ".join(place.kinds), told.get(VARIANT), description)
        place_of = {id(group): group for group in place.kinds.values()}
        for group in place_of.values():
            names = [name for name, other in place.kinds.items() if other is group]
            own = told if told.get(VARIANT) in names else group.defaults
            yield from _list_group(group, own, at, " | ".join(names))
    else:
        yield from _list_group(place, told, at, kind)


def _list_group(group: Place, told: Mapping[str, Any], at: str, kind: str) -> Iterator[Parameter]:
    for name, place in group.properties.items():
        value = told.get(name)
        if name == VARIANT and kind:
            continue
        if place.is_group and isinstance(value, dict):
            yield from list_parameters(place, cast(dict[str, Any], value), f"{at}{name}.", kind)
        else:
            yield Parameter(f"{at}{name}", kind, _describe_values(place), value, place.schema.get("description", ""))


def _describe_values(place: Place) -> str:
    if place.choices:
        return " | ".join(map(str, place.choices))
    schema = place.schema
    limits = ", ".join(f"{sign} {schema[word]:g}" for word, sign in RANGES.items() if word in schema)
    kind = str(schema.get("type", "group" if place.is_group else ""))
    return ", ".join(part for part in (kind, limits, "or null" if place.nullable else "") if part)


def _write(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)
