"""Parameters that a stage does not look at because of what it reads: they would change a key and nothing else.

A parameter's schema may say, by `x-without`, a port that has to be unread for the parameter to act (the size of a
field, where an initial field brings its own), by `x-with`, one that has to be read, by `x-under` the value that another
parameter has to have, or the values of which it has to have one, and by `x-unless` the value that it must not have. The
other parameter is one of its own group, or named by its path from the top (`architecture.sampler`).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, cast

from inpaint3d.contracts.models.pipeline import Parameters
from inpaint3d.orchestrator.parameter_schema import Place
from inpaint3d.orchestrator.parameters import fill_defaults
from inpaint3d.orchestrator.prune import spell

WITH, WITHOUT, UNDER, UNLESS = "x-with", "x-without", "x-under", "x-unless"
Read = Mapping[str, Sequence[str]]
"""Port -> references, of the ports that a node reads."""


def find_unused(whole: Place, parameters: Parameters, read: Read, wired: Collection[str], node: str) -> Iterator[str]:
    """What is not its default and does not act, with the way to make it, in words.

    parameters: defaults filled in. wired: the ports that could be read; a parameter that says whether one is read acts
    where there is something to read.
    """
    for at, place, group in _list_set(whole, parameters, node):
        without, needed = place.written.get(WITHOUT), place.written.get(WITH)
        if without is not None and without in read:
            sources = ", ".join(read[without])
            yield f"{at} changes nothing where {without} ({sources}) is read{_say_ways(whole, node, without)}"
        if needed is not None and needed not in (wired if place.reads else read):
            yield f"{at} changes nothing where no {needed} is {'wired' if place.reads else 'read'}"
        yield from _find_conflicts(at, place, group, parameters, node)


def _find_conflicts(at: str, place: Place, group: Parameters, parameters: Parameters, node: str) -> Iterator[str]:
    """Values of other parameters under which one does not act, in words."""

    def look_up(path: str) -> tuple[str, Any]:
        first, *rest = path.split(".")
        inside, value = (at.rpartition(".")[0], group) if first in group else (node, parameters)
        for name in (first, *rest):
            value = value[name]
        return f"{inside}.{path}", value

    for path, wanted in cast(Parameters, place.written.get(UNDER, {})).items():
        values = cast(list[Any], wanted if isinstance(wanted, list) else [wanted])
        where, value = look_up(path)
        if value not in values:
            yield f"{at} changes nothing: it counts under {' or '.join(f'{where}={spell(v)}' for v in values)}"
    for path, unwanted in cast(Parameters, place.written.get(UNLESS, {})).items():
        where, value = look_up(path)
        if value == unwanted:
            yield f"{at} changes nothing under {where}={spell(value)}"


def _list_set(place: Place, value: Parameters, at: str) -> Iterator[tuple[str, Place, Parameters]]:
    """(path, place, values of its group) of every parameter that is not its default.

    What a group's schema says counts for all inside it.
    """
    group = place.group_of(value)
    for name, inner in ({} if group is None else group.properties).items():
        default = fill_defaults(inner, inner.schema.get("default"))
        if value.get(name) is None or value[name] == default:
            continue
        if isinstance(value[name], dict):
            if WITH in inner.written or WITHOUT in inner.written:
                yield f"{at}.{_name_changed(name, value[name], default)}", inner, value
            yield from _list_set(inner, value[name], f"{at}.{name}")
        else:
            yield f"{at}.{name}", inner, value


def _name_changed(name: str, value: Parameters, default: Any) -> str:
    """The group's first parameter that is not its default."""
    usual = cast(Parameters, default or {})
    return f"{name}.{next(inner for inner, v in value.items() if v != usual.get(inner))}"


def _say_ways(whole: Place, node: str, port: str) -> str:
    """The settings under which a port is not read; empty where there is none."""
    ways = [
        f"{node}.{name}={value}"
        for name, place in whole.properties.items()
        if place.reads and any(port in ports for ports in place.reads.values())
        for value in place.choices
        if port not in place.reads.get(value, [])
    ]
    return f"; under {' or '.join(ways)} it is not" if ways else ""
