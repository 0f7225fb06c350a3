"""Effects on a command line, and as a run found them. Which there are, the stages' own parameters say."""

import difflib
from collections.abc import Sequence
from typing import Any

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import EffectPlan
from inpaint3d.contracts.models.pipeline import Pipeline
from inpaint3d.contracts.models.report import EffectFigures, RunRecord
from inpaint3d.contracts.store import Record, Store
from inpaint3d.orchestrator.parameter_schema import parameter_schema
from inpaint3d.orchestrator.parameters import Overrides

FORCE = "force"
PLAN_PORT = "effect-plan"
COSTS = "effect-costs"
STATES = {"on": True, "off": False, "auto": None}


def switch_effects(pipeline: Pipeline, lines: Sequence[str], overrides: Overrides) -> Overrides:
    """Overrides with `NAME=on|off|auto` lines put into the stages that decide these effects.

    Raises ConfigurationError for a name or a state that there is not, and for two that contradict each other.
    """
    deciders = find_deciders(pipeline)
    asked: dict[str, bool | None] = {}
    for line in lines:
        name, _, state = line.partition("=")
        if name not in deciders:
            near = difflib.get_close_matches(name, deciders, n=1)
            hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(deciders)}"
            raise ConfigurationError(f"--effect {line}: no effect {name} can be switched; {hint}")
        if state not in STATES:
            raise ConfigurationError(f"--effect {line}: write {name}=on, {name}=off or {name}=auto")
        if asked.setdefault(name, STATES[state]) != STATES[state]:
            raise ConfigurationError(f"--effect {line} contradicts another --effect {name}; leave one out")
    switched = {node: dict(values) for node, values in overrides.items()}
    for name, on in asked.items():
        for node in deciders[name]:
            values = switched.setdefault(node, {}) if on is not None else switched.get(node, {})
            given = values.get(FORCE, {})
            if name in given and given[name] != on:
                raise ConfigurationError(f"--effect {name} contradicts --set {node}.{FORCE}; leave one out")
            if on is not None:
                values[FORCE] = {**given, name: on}
    return switched


def find_deciders(pipeline: Pipeline) -> dict[str, list[str]]:
    """Effect -> the nodes whose parameter `force` takes it."""
    found: dict[str, list[str]] = {}
    for node in pipeline.order:
        place = parameter_schema(pipeline, node).properties.get(FORCE)
        names: dict[str, Any] = place.schema.get("propertyNames", {}) if place else {}
        for name in names.get("enum", [names["const"]] if "const" in names else []):
            found.setdefault(name, []).append(node)
    return found


def find_analysis(pipeline: Pipeline) -> str:
    """The node that writes the effect plan; ConfigurationError where none does."""
    for node in pipeline.order:
        if PLAN_PORT in pipeline.stages[node].spec.outputs:
            return node
    raise ConfigurationError(f"no stage of {pipeline.path} decides effects; leave out --effects")


def read_effects(store: Store, record: RunRecord) -> tuple[EffectFigures, ...]:
    """What a run decided, with what it costs on the machine that decided it; nothing where it decided none."""
    for node in record.nodes:
        if (digest := node.outputs.get(PLAN_PORT)) is not None:
            found = store.lookup(node.key, verify=False) if node.key else None
            costs = _find_costs(found)
            plan = store.open(digest, EffectPlan).metadata
            return tuple(
                EffectFigures(
                    effect=effect,
                    step_ratio=costs.get(effect.name, {}).get("ratio"),
                    step_cpu_ms=costs.get(effect.name, {}).get("step_cpu_ms"),
                    learnt_bytes=costs.get(effect.name, {}).get("bytes"),
                )
                for effect in plan.effects
            )
    return ()


def _find_costs(record: Record | None) -> dict[str, dict[str, Any]]:
    """Effect -> the row of the series that the probe recorded; empty where costs were not measured."""
    series: dict[str, list[dict[str, Any]]] = record.timings.get("series", {}) if record else {}
    return {row["effect"]: row for row in series.get(COSTS, []) if "effect" in row}
