"""The published schema of a stage's parameters, place by place: groups, the kinds of a group, their defaults."""

import functools
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Self, cast

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import VARIANT, Pipeline

Schema = dict[str, Any]
READS = "x-reads"


@dataclass(frozen=True)
class Place:
    """A parameter, or a group of them: plain, or one of several kinds that its `name` tells apart."""

    root: Schema
    written: Schema
    """As it stands in the document, with its references."""

    @cached_property
    def schema(self) -> Schema:
        """With references followed; of `X or null`, X."""
        schema = self.written
        while True:
            options = [o for o in schema.get("anyOf", []) if o.get("type") != "null"]
            if "$ref" in schema:
                target = self.root["$defs"][schema["$ref"].rpartition("/")[2]]
                schema = {**target, **{k: v for k, v in schema.items() if k != "$ref"}}
            elif len(options) == 1:
                schema = {**options[0], **{k: v for k, v in schema.items() if k != "anyOf"}}
            else:
                return schema

    @cached_property
    def kinds(self) -> dict[str, Self]:
        """`name` -> the group that it stands for; empty for what has one kind alone."""
        if self.schema.get("discriminator", {}).get("propertyName") != VARIANT:
            return {}
        groups = [self._inside(option) for option in self.schema["oneOf"]]
        return {kind: group for group in groups for kind in group._own_kinds}

    @property
    def _own_kinds(self) -> list[str]:
        tag = self.properties[VARIANT].schema
        return tag["enum"] if "enum" in tag else [tag["const"]]

    @cached_property
    def properties(self) -> dict[str, Self]:
        """The parameters of a plain group."""
        return {name: self._inside(schema) for name, schema in self.schema.get("properties", {}).items()}

    @property
    def is_group(self) -> bool:
        return bool(self.kinds or self.properties)

    @property
    def nullable(self) -> bool:
        return {"type": "null"} in self.written.get("anyOf", [])

    @property
    def items(self) -> Self | None:
        """What a list holds, where that is one schema."""
        items = self.schema.get("items")
        return self._inside(cast(Schema, items)) if isinstance(items, dict) else None

    @property
    def defaults(self) -> dict[str, Any]:
        """Those of a plain group's parameters, as they are written."""
        return {name: p.schema["default"] for name, p in self.properties.items() if "default" in p.schema}

    @property
    def required(self) -> list[str]:
        return self.schema.get("required", [])

    @property
    def reads(self) -> dict[str, list[str]] | None:
        """Value -> the ports that the stage reads under it; None where the parameter has no say in that."""
        return self.written.get(READS)

    @property
    def choices(self) -> list[str]:
        """The kinds of a group, or the values of an enumeration, in the order of the stage's own code."""
        return list(self.kinds) or self.schema.get("enum", [])

    def group_of(self, value: Any) -> Self | None:
        """The plain group that a value is of; None where it names a kind that there is not, or none."""
        return self.kinds.get(str(value.get(VARIANT))) if self.kinds else self

    def find(self, name: str, at: str) -> Iterator[tuple[str, str | None]]:
        """(path, kind) of every parameter of this name below here, however deep; kind: of a group around it."""
        for kind, group in self.kinds.items() or [(None, self)]:
            for inner, place in group.properties.items():
                if inner == name:
                    yield f"{at}.{inner}", kind
                yield from ((path, deeper or kind) for path, deeper in place.find(name, f"{at}.{inner}"))

    def _inside(self, schema: Schema) -> Self:
        return type(self)(self.root, schema)


@functools.cache
def _read(path: Path) -> Place:
    try:
        schema = cast(Schema, json.loads(path.read_text()))
    except FileNotFoundError as error:
        raise ConfigurationError(f"{path} is not there; run `make schemas`") from error
    return Place(schema, schema)


def parameter_schema(pipeline: Pipeline, node: str) -> Place:
    """The schema of all parameters of a node."""
    name = pipeline.stages[node].metadata.name
    return _read(pipeline.path.parent / "schemas" / "parameters" / f"{name}.json")
