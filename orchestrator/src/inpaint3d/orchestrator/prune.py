"""Which nodes run: those whose results are wanted, and those that these read under their parameters.

A parameter's schema may say, by `x-reads`, which ports the stage reads under each of its values; `a|b` stands for the
first of these ports that has something wired and given. A port that such a list names is read only if every parameter
that names it does so under its current value; ports that none names are always read.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, cast

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.pipeline import VARIANT, Parameters, Pipeline, Reference
from inpaint3d.orchestrator.parameter_schema import Place, parameter_schema


@dataclass(frozen=True)
class Unread:
    """A port that a node does not read, and the parameter that says so."""

    node: str
    port: str
    parameter: str
    value: str
    readers: tuple[str, ...]
    """Values of the parameter under which it would be read."""
    instead: str | None
    """The port that is read in its place."""

    def __str__(self) -> str:
        if self.instead is not None:
            return f"{self.node} reads {self.instead} instead of {self.port}"
        return f"{self.node}'s {self.parameter} {self.value} does not read {self.port}"

    @property
    def remedy(self) -> str:
        """The setting under which the port is read; empty where there is none."""
        if len(self.readers) < 2:
            return "".join(f"--set {self.node}.{self.parameter}={value}" for value in self.readers)
        return f"--set {self.node}.{self.parameter}=VALUE ({', '.join(self.readers[:-1])} or {self.readers[-1]})"


@dataclass(frozen=True)
class PrunedPipeline:
    """What is left of a pipeline: `pipeline` without the nodes and ports that nobody asks for, out of `whole`."""

    pipeline: Pipeline
    whole: Pipeline
    unread: tuple[Unread, ...]
    """Of the nodes that run."""

    @property
    def left_out(self) -> dict[str, str]:
        """Node -> why it does not run."""
        return {node: self._explain_reading(node) for node in self.whole.order if node not in self.pipeline.nodes}

    def remedy(self, node: str) -> str:
        """What on the command line makes a node run that was left out."""
        ways = [u.remedy for u in self._list_unread(node) if u.remedy]
        return " or ".join([*dict.fromkeys(ways), f"--until {node}"]) + " runs it"

    def reason_unread(self, external: str) -> str | None:
        """Why no node that runs reads what is given from outside, and how one would; None where one does."""
        reference = f"external.{external}"
        readers = [n for n in self.whole.order if _find_ports(self.whole, n, reference)]
        if any(_find_ports(self.pipeline, n, reference) for n in self.pipeline.order):
            return None
        for unread in self.unread:
            if unread.port in _find_ports(self.whole, unread.node, reference):
                return f"{unread}" + (f"; {unread.remedy} does" if unread.remedy else "")
        for node in readers:
            if node not in self.pipeline.nodes:
                return f"{node}, which reads it, is left out ({self.left_out[node]}); {self.remedy(node)}"
        return f"no node of {self.whole.path} reads {reference}"

    def _explain_reading(self, node: str) -> str:
        if node in self.whole.spec.spec.compare:
            return "a control; --compare runs it"
        readers = [n for n in self.whole.order if node in self.whole.upstream(n)]
        said = [str(u) for u in self._list_unread(node)]
        if not readers:
            return f"wanted by no preset; --want {node} runs it"
        said += [f"{n}, which reads it, is left out" for n in readers if n not in self.pipeline.nodes]
        if not said:
            said = [f"{n} reads it only if it is made anyway" for n in readers]
        return "nothing asks for it: " + "; ".join(said)

    def _list_unread(self, node: str) -> list[Unread]:
        outputs = [f"{node}.{port}" for port in self.whole.stages[node].spec.outputs]
        return [u for u in self.unread if any(u.port in _find_ports(self.whole, u.node, o) for o in outputs)]


def _find_ports(pipeline: Pipeline, node: str, reference: str) -> list[str]:
    """The ports of a node that a reference is wired to."""
    return [port for port, references in pipeline.references(node).items() if reference in references]


def prune(
    pipeline: Pipeline, parameters: Mapping[str, Parameters], wanted: Collection[str], given: Collection[str]
) -> PrunedPipeline:
    """Keep the wanted nodes and what they read.

    parameters: of every node, all defaults filled in. given: the externals that there are. Raises ConfigurationError
    where a port that has to have something is left with nothing.
    """
    unread = {node: find_unread_ports(pipeline, node, parameters[node], given) for node in pipeline.order}
    kept: set[str] = set()
    waiting = list(wanted)
    while waiting:
        if (node := waiting.pop()) not in kept:
            kept.add(node)
            waiting += _find_sources(pipeline, node, {u.port for u in unread[node]})
    there = {*kept, "external"}
    controls = set(pipeline.spec.spec.compare) - set(wanted)
    inputs = {
        node: _keep_inputs(pipeline, node, {u.port for u in unread[node]}, there, controls) for node in pipeline.order
    }
    return PrunedPipeline(
        pipeline=pipeline.keep({node: inputs[node] for node in pipeline.order if node in kept}),
        whole=pipeline,
        unread=tuple(u for node in pipeline.order if node in kept for u in unread[node]),
    )


def _find_sources(pipeline: Pipeline, node: str, unread: set[str]) -> list[str]:
    """The nodes that have to run for this one."""
    ports = pipeline.stages[node].spec.inputs
    read = [refs for port, refs in pipeline.references(node).items() if port not in unread and not ports[port].weak]
    return [source for refs in read for ref in refs if (source := ref.split(".")[0]) != "external"]


def _keep_inputs(
    pipeline: Pipeline, node: str, unread: set[str], there: Collection[str], controls: Collection[str]
) -> dict[str, Reference | list[Reference]]:
    """What a node reads of the nodes that are there; a weak port leaves controls out that nobody wants to see."""
    ports = pipeline.stages[node].spec.inputs
    found: dict[str, Reference | list[Reference]] = {}
    for port, references in pipeline.references(node).items():
        passed_over = controls if ports[port].weak else ()
        sources = [(r, r.split(".")[0]) for r in ([] if port in unread else references)]
        left = [r for r, source in sources if source in there and source not in passed_over]
        if left:
            found[port] = left if ports[port].list else left[0]
        elif not ports[port].optional and node in there:
            raise ConfigurationError(f"{node}: nothing at its input {port} ({', '.join(references)})")
    return found


def find_unread_ports(pipeline: Pipeline, node: str, parameters: Parameters, given: Collection[str]) -> list[Unread]:
    """The ports that a node has and does not read under these parameters."""
    wired = {
        port
        for port, references in pipeline.references(node).items()
        if any(not r.startswith("external.") or r.partition(".")[2] in given for r in references)
    }
    found: list[Unread] = []
    for name, place in parameter_schema(pipeline, node).properties.items():
        if place.reads is None:
            continue
        value = spell(parameters[name])
        asked = [entry.split("|") for entry in place.reads.get(value, [])]
        read = {_choose_first(ports, wired): ports for ports in asked}
        for port in sorted(_find_governed(pipeline, node, place, name) - set(read)):
            instead = next((first for first, ports in read.items() if port in ports), None)
            readers = [v for v in place.choices if any(port in e.split("|") for e in place.reads.get(v, []))]
            found.append(Unread(node, port, name, value, () if instead else tuple(readers), instead))
    return found


def spell(value: Any) -> str:
    """A parameter's value as a key of `x-reads`, and in words: text as it is, a group's kind, anything else as JSON."""
    told = cast(Parameters, value)[VARIANT] if isinstance(value, dict) else value
    return told if isinstance(told, str) else json.dumps(told)


def _choose_first(ports: list[str], wired: Collection[str]) -> str:
    """The first of some ports that has something."""
    return next((port for port in ports if port in wired), ports[0])


def _find_governed(pipeline: Pipeline, node: str, place: Place, name: str) -> set[str]:
    ports = {port for entries in (place.reads or {}).values() for entry in entries for port in entry.split("|")}
    if strange := sorted(ports - set(pipeline.stages[node].spec.inputs)):
        raise ConfigurationError(f"{node}: x-reads of {name} names {strange[0]}, which is no input of its stage")
    return ports
