"""`pipeline.yaml`: the DAG of stages, their wiring and parameters.

No code, no expressions, and no conditions but the presets that a node may be limited to.
"""

import copy
import functools
import graphlib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from pydantic import Field, StringConstraints

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.base import Closed, PortName
from inpaint3d.contracts.models.documents import line_of, load_document
from inpaint3d.contracts.models.manifest import is_compatible, split_schema
from inpaint3d.contracts.models.stage import Name, StageSpec, load_stage
from inpaint3d.contracts.models.untrusted import Location

Reference = Annotated[
    str,
    Field(description="NODE.PORT of another node, or external.NAME"),
    StringConstraints(pattern=r"^[a-z][a-z0-9-]*\.[a-z][a-z0-9-]*$"),
]
Parameters = dict[str, Any]
VARIANT = "name"
"""The parameter by which a group says which of several kinds it is."""


def merge_parameters(under: Any, over: Any) -> Any:
    """`over` on top of `under`: groups parameter by parameter, anything else as a whole.

    A group of another kind (`name`) starts anew; a bare string over or under a group is its kind.
    """
    if isinstance(under, dict) and isinstance(over, str):
        over = {VARIANT: over}
    if isinstance(under, str) and isinstance(over, dict):
        under = {VARIANT: under}
    if not (isinstance(under, dict) and isinstance(over, dict)):
        return cast(Any, over)
    below, above = cast(Parameters, under), cast(Parameters, over)
    if VARIANT in above and above[VARIANT] != below.get(VARIANT):
        return above
    return {**below, **{n: merge_parameters(below[n], v) if n in below else v for n, v in above.items()}}


class External(Closed):
    """An artifact that comes from outside: the capture, a mask request, a prior."""

    schema_range: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9-]*@\d+$")] = Field(alias="schema")
    optional: bool = False
    default: str | None = Field(
        default=None, description="artifact folder, relative to pipeline.yaml, if none is given"
    )


class Node(Closed):
    """One use of a stage. Two nodes may use the same stage with different parameters, or with different seeds."""

    name: Name
    stage: str = Field(description="the stage's folder, relative to pipeline.yaml")
    inputs: dict[PortName, Reference | list[Reference]]
    parameters: Parameters = {}
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="added to the run's seed")
    presets: list[Name] = Field(default=[], description="the presets that have this node; none named: all do")

    def belongs_to(self, preset: str | None) -> bool:
        """Whether a run under this preset has the node; None: under no preset."""
        return not self.presets or preset in self.presets


class PipelineBody(Closed):
    externals: dict[Name, External]
    stages: list[Node]
    wants: list[Name] = Field(
        default=[],
        description="the nodes whose results a run is for; others run where these read them; none named: all",
    )
    compare: list[Name] = Field(default=[], description="nodes that the result is compared with: wanted by --compare")
    presets: dict[Name, dict[Name, Parameters]] = Field(default={}, description="preset -> node -> parameters")
    defaultPreset: Name | None = None  # noqa: N815 - Kubernetes' spelling


class PipelineMetadata(Closed):
    name: Name


class PipelineSpec(Closed):
    """The whole of `pipeline.yaml`."""

    apiVersion: Literal["inpaint3d/v1"]  # noqa: N815
    kind: Literal["Pipeline"]
    metadata: PipelineMetadata
    spec: PipelineBody


class Pipeline:
    """A checked pipeline: nodes in an order in which each comes after what it reads."""

    def __init__(self, path: Path) -> None:
        """Read `pipeline.yaml` and every `stage.yaml` that it names; ConfigurationError with file and line."""
        self.path = path
        self.spec, self._lines = load_document(path, PipelineSpec)
        self.nodes: dict[str, Node] = {}
        self.stages: dict[str, StageSpec] = {}
        for i, node in enumerate(self.spec.spec.stages):
            if node.name in self.nodes:
                self._fail(("spec", "stages", i, "name"), f"a second node is called {node.name}; rename one")
            file = path.parent / node.stage / "stage.yaml"
            if not file.is_file():
                self._fail(("spec", "stages", i, "stage"), f"{node.name}: there is no {file}")
            self.nodes[node.name] = node
            self.stages[node.name] = load_stage(file)
        self._wire()
        for i, node in enumerate(self.spec.spec.stages):
            self._check_ports(i, node)
        self.order = self._sort_nodes()
        self._check_presets()
        self._check_wants()

    def under(self, preset: str | None) -> Self:
        """The pipeline with the nodes that a preset has; list ports lose their references to others."""
        there = {name for name, node in self.nodes.items() if node.belongs_to(preset)}

        def keep_present(value: Reference | list[Reference]) -> Reference | list[Reference]:
            single = isinstance(value, str)
            return value if single else [r for r in value if r.split(".")[0] in {*there, "external"}]

        return self.keep(
            {
                name: {port: keep_present(value) for port, value in node.inputs.items()}
                for name, node in self.nodes.items()
                if name in there
            }
        )

    def keep(self, inputs: Mapping[str, Mapping[PortName, Reference | list[Reference]]]) -> Self:
        """The pipeline with these nodes alone, each reading these of its ports."""
        chosen = copy.copy(self)
        chosen.order = [name for name in self.order if name in inputs]
        chosen.stages = {name: self.stages[name] for name in self.nodes if name in inputs}
        chosen.nodes = {
            name: node.model_copy(update={"inputs": dict(inputs[name])})
            for name, node in self.nodes.items()
            if name in inputs
        }
        chosen._wire()
        return chosen

    def _wire(self) -> None:
        """Who reads what, once: planning asks for it at every node of every scene."""
        self._references: dict[str, dict[str, list[str]]] = {
            name: {port: value if isinstance(value, list) else [value] for port, value in node.inputs.items()}
            for name, node in self.nodes.items()
        }
        self._upstream = {
            name: frozenset(ref.split(".")[0] for refs in ports.values() for ref in refs) - {"external"}
            for name, ports in self._references.items()
        }

    def references(self, node: str) -> Mapping[str, list[str]]:
        """Input port -> references, single ones as a list of one."""
        return self._references[node]

    def upstream(self, node: str) -> frozenset[str]:
        """The nodes that a node reads from directly."""
        return self._upstream[node]

    def downstream(self, node: str) -> set[str]:
        """Every node that depends on this one, however far."""
        found: set[str] = set()
        for name in self.order:
            if self.upstream(name) & (found | {node}):
                found.add(name)
        return found

    def parameters(self, node: str, preset: str | None, defaults: Parameters | None = None) -> Parameters:
        """The node's parameters over the defaults, with the preset's over both."""
        presets = self.spec.spec.presets
        if preset is not None and preset not in presets:
            raise ConfigurationError(f"no preset {preset!r} in {self.path}; there are {', '.join(presets)}")
        chosen = presets.get(preset or "", {})
        layers = [self.nodes[node].parameters, chosen.get(node, {})]
        return functools.reduce(merge_parameters, layers, defaults or {})

    def _fail(self, at: Location, message: str) -> None:
        raise ConfigurationError(f"{self.path}:{line_of(self._lines, at)}: {message}")

    def _check_ports(self, i: int, node: Node) -> None:
        ports = self.stages[node.name].spec.inputs
        at: Location = ("spec", "stages", i, "inputs")
        for port, value in node.inputs.items():
            if port not in ports:
                self._fail((*at, port), f"{node.name} has no input {port}; it has {', '.join(ports)}")
            if isinstance(value, list) != ports[port].list:
                form = "a list of references" if ports[port].list else "one reference"
                self._fail((*at, port), f"{node.name}.{port} takes {form}")
            for reference in value if isinstance(value, list) else [value]:
                self._check_reference((*at, port), node, port, reference)
        for port, declared in ports.items():
            if port not in node.inputs and not declared.optional:
                self._fail(at, f"{node.name}: its input {port} is not wired")

    def _check_reference(self, at: Location, node: Node, port: str, reference: str) -> None:
        source, name = reference.split(".")
        wanted = self.stages[node.name].spec.inputs[port]
        if source == "external":
            external = self.spec.spec.externals.get(name)
            if external is None:
                self._fail(at, f"{reference}: no external {name}; there are {', '.join(self.spec.spec.externals)}")
                return
            offered, optional = external.schema_range + ".0", external.optional
        else:
            if source not in self.nodes:
                self._fail(at, f"{reference}: no node {source}; there are {', '.join(self.nodes)}")
            output = self.stages[source].spec.outputs.get(name)
            if output is None:
                outputs = ", ".join(self.stages[source].spec.outputs)
                self._fail(at, f"{reference}: {source} has no output {name}; it has {outputs}")
                return
            offered, optional = output.schema_id, output.optional
            if not wanted.list and (lacking := self._find_preset_without(self.nodes[source], node)):
                self._fail(at, f"{reference}: preset {lacking} has {node.name}, but not {source}")
        if not is_compatible(offered, wanted.schema_range):
            self._fail(at, f"{reference} is {offered}, but {node.name}.{port} takes {wanted.schema_range}")
        if optional and not (wanted.optional or wanted.list):
            kind = split_schema(offered)[0]
            self._fail(at, f"{reference} may be absent, but {node.name}.{port} needs a {kind}")

    def _find_preset_without(self, source: Node, reader: Node) -> str | None:
        """A preset that has the reader and not its source."""
        presets = (None, *self.spec.spec.presets)
        found = [p for p in presets if reader.belongs_to(p) and not source.belongs_to(p)]
        return (found[0] or "(none)") if found else None

    def _sort_nodes(self) -> list[str]:
        graph = {name: self.upstream(name) for name in self.nodes}
        try:
            return list(graphlib.TopologicalSorter(graph).static_order())
        except graphlib.CycleError as error:
            cycle = " -> ".join(error.args[1])
            i = list(self.nodes).index(error.args[1][0])
            self._fail(("spec", "stages", i), f"the stages go in a circle: {cycle}")
            raise

    def _check_presets(self) -> None:
        body = self.spec.spec
        for preset, nodes in body.presets.items():
            for node in nodes:
                if node not in self.nodes:
                    self._fail(
                        ("spec", "presets", preset, node),
                        f"no node {node}; there are {', '.join(self.nodes)}",
                    )
        for i, node in enumerate(body.stages):
            for preset in node.presets:
                if preset not in body.presets:
                    self._fail(("spec", "stages", i, "presets"), f"{node.name}: no preset {preset}")
        if body.defaultPreset is not None and body.defaultPreset not in body.presets:
            self._fail(("spec", "defaultPreset"), f"no preset {body.defaultPreset}")

    def _check_wants(self) -> None:
        for role in ("wants", "compare"):
            for i, name in enumerate(cast(list[str], getattr(self.spec.spec, role))):
                if name not in self.nodes:
                    self._fail(("spec", role, i), f"no node {name}; there are {', '.join(self.nodes)}")
