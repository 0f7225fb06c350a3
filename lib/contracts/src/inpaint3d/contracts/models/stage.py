"""`stage.yaml`: what a stage reads and writes, which image it runs in, what it needs. Kubernetes in form."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, field_validator

from inpaint3d.contracts.errors import MEANINGS, ConfigurationError
from inpaint3d.contracts.models.artifacts import SCHEMAS
from inpaint3d.contracts.models.base import Closed, PortName
from inpaint3d.contracts.models.documents import line_of, load_document
from inpaint3d.contracts.models.manifest import SchemaId, split_schema

API_VERSION = "inpaint3d/v1"
Name = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9-]*$")]
Quantity = Annotated[str, StringConstraints(pattern=r"^\d+(\.\d+)?(m|Ki|Mi|Gi|Ti)?$")]


_FACTORS = {"m": 1e-3, "Ki": 2**10, "Mi": 2**20, "Gi": 2**30, "Ti": 2**40}


def memory_bytes(quantity: Quantity) -> int:
    """`8Gi` -> 8589934592."""
    return int(_read_quantity(quantity))


def count_cpus(quantity: Quantity) -> float:
    """`1500m` -> 1.5."""
    return _read_quantity(quantity)


def _read_quantity(quantity: Quantity) -> float:
    for suffix, factor in _FACTORS.items():
        if quantity.endswith(suffix):
            return float(quantity.removesuffix(suffix)) * factor
    return float(quantity)


class InputPort(Closed):
    """What a port takes: any minor of one schema major."""

    schema_range: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9-]*@\d+$")] = Field(alias="schema")
    optional: bool = False
    list: bool = False
    weak: bool = Field(
        default=False, description="what is wired here is read if it is made anyway; it makes nothing run"
    )


class OutputPort(Closed):
    """What a port writes."""

    schema_id: SchemaId = Field(alias="schema")
    optional: bool = Field(default=False, description="not every input gives one")


class Resources(Closed):
    requests: dict[str, Quantity] = {"cpu": "1", "memory": "1Gi"}
    limits: dict[str, Quantity] = {}


class Tolerance(Closed):
    tolerance: str = Field(description="what may differ between two runs of one key, and by how much")


class StageMetadata(Closed):
    name: Name
    version: Annotated[str, StringConstraints(pattern=r"^\d+\.\d+\.\d+$")]


class StageBody(Closed):
    description: str
    image: str
    module: Annotated[str, StringConstraints(pattern=r"^[a-z0-9_.]+$")]
    inputs: dict[PortName, InputPort]
    outputs: dict[PortName, OutputPort]
    resources: Resources = Resources()
    gpu: Literal["none", "optional"] = "none"
    determinism: Literal["exact"] | Tolerance = "exact"
    activeDeadlineSeconds: Annotated[int, Field(ge=1)] | None = None  # noqa: N815 - Kubernetes' spelling
    exitCodes: dict[str, str] = Field(  # noqa: N815
        default={}, validate_default=True, description="what this stage adds to what every stage's codes mean"
    )

    @field_validator("exitCodes")
    @classmethod
    def _merge_common_codes(cls, given: dict[str, str]) -> dict[str, str]:
        merged = {**MEANINGS, **given}
        return {code: merged[code] for code in sorted(merged, key=int)}


class StageSpec(Closed):
    """The whole of `stage.yaml`."""

    apiVersion: Literal["inpaint3d/v1"]  # noqa: N815
    kind: Literal["Stage"]
    metadata: StageMetadata
    spec: StageBody

    @property
    def id(self) -> str:
        return f"{self.metadata.name}@{self.metadata.version}"


def load_stage(path: Path) -> StageSpec:
    """Read and check a `stage.yaml`. Raises ConfigurationError with file and line."""
    spec, lines = load_document(path, StageSpec)
    ports = [("inputs", n, p.schema_range) for n, p in spec.spec.inputs.items()]
    ports += [("outputs", n, p.schema_id) for n, p in spec.spec.outputs.items()]
    for side, name, schema in ports:
        known, major, _ = split_schema(schema)
        line = line_of(lines, ("spec", side, name))
        if known not in SCHEMAS:
            raise ConfigurationError(f"{path}:{line}: {name}: no schema {known}; there are {', '.join(SCHEMAS)}")
        if side == "outputs" and schema != f"{known}@{SCHEMAS[known][0]}":
            raise ConfigurationError(
                f"{path}:{line}: {name}: this code writes {known}@{SCHEMAS[known][0]}, not {schema}"
            )
        if major < 1:
            raise ConfigurationError(f"{path}:{line}: {name}: schema majors start at 1")
    return spec
