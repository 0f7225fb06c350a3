"""docs/effects.md is what the effects' modules say; `python -m tests.docs.test_effects` writes its tables anew."""

import importlib
import json
import re
from pathlib import Path

from benchmarks.effects.verdicts import WORTH_DB
from benchmarks.pages import fill_between

from inpaint3d.scene.effects import DECIDED_IN, load
from inpaint3d.scene.effects.description import Description

PAGE = Path(__file__).parents[2] / "docs/effects.md"
RESULTS = PAGE.parents[1] / "benchmarks/results/effects.json"
HEAD = ["| effect | evidence | off means | on beyond | decided in |", "|---|---|---|---|---|"]


def build_parts() -> dict[str, str]:
    """Marker -> what belongs between it and its end."""
    found = [load(name).EFFECT for name in DECIDED_IN]
    rows = [write_row(effect) for effect in found if effect.simulated_by is not None]
    noticed = [f"- `{e.name}`: {e.what}. Noticed by: {e.evidence}." for e in found if e.simulated_by is None]
    return {
        "effects": "\n" + "\n".join([*HEAD, *rows]) + "\n",
        "measured": "\n" + "\n".join(write_measured()) + "\n",
        "not-modelled": "\n" + "\n".join(["Noticed, and not simulated:", "", *noticed]) + "\n",
    }


def write_row(effect: Description) -> str:
    """A row of the table."""
    beyond = f"{effect.material:g} {effect.unit}" if effect.unit else f"by `{effect.parameter}`"
    if effect.least_gain > 0:
        beyond += f"; {effect.least_gain:.0%} explained"
    what = f"`{effect.name}`: {effect.what}"
    return f"| {what} | {effect.evidence} | {effect.off_means} | {beyond} | {DECIDED_IN[effect.name]} |"


def write_measured() -> list[str]:
    """Decisions against what fits measured, as far as they were."""
    found = json.loads(RESULTS.read_text())
    head = [
        "| captures with | on, worth it | on, not worth it | off, worth it | off, not worth it |",
        "|---|---|---|---|---|",
    ]
    rows = {**found["by_effect"], **{f"all, {half}": row for half, row in found["confusion"].items()}}
    counts = ("on_and_worth", "on_not_worth", "off_and_worth", "off_not_worth")
    table = [f"| {name} | {' | '.join(str(row[count]) for count in counts)} |" for name, row in rows.items()]
    settings, missed = found["settings"], found["largest_missed_db"]
    return [
        f"Fits of {settings['steps']} steps of {settings['rays']} rays; worth it: clean held-out views gain more than "
        f"{WORTH_DB:g} dB. The most that an effect that was off would have gained: {missed:.2f} dB.",
        "",
        *head,
        *table,
    ]


def fill_in(text: str) -> str:
    for name, part in build_parts().items():
        text = fill_between(text, name, part)
    return text


def test_the_page_is_what_the_modules_say():
    assert PAGE.read_text() == fill_in(PAGE.read_text()), "run `python -m tests.docs.test_effects`"


def test_what_simulates_an_effect_is_there():
    for name in DECIDED_IN:
        if (dotted := load(name).EFFECT.simulated_by) is not None:
            module, _, attribute = dotted.rpartition(".")
            if attribute[0].islower() and module.rpartition(".")[2][0].isupper():
                module, _, owner = module.rpartition(".")
                source = Path(importlib.import_module(module).__file__ or "").read_text()
                assert f"class {owner}" in source
                assert re.search(rf"\b{attribute}\b", source), dotted
            else:
                assert hasattr(importlib.import_module(module), attribute), dotted


def test_every_effect_that_code_asks_for_is_an_effect():
    """`active("NAME")` of a name that there is not would be off for ever, in silence."""
    sources = [p for f in ("lib", "stages") for p in (PAGE.parents[1] / f).rglob("*/src/**/*.py")]
    asked = {name for path in sources for name in re.findall(r"\.active\(\"([a-z-]+)\"\)", path.read_text())}
    assert asked
    assert asked <= set(DECIDED_IN)


if __name__ == "__main__":
    PAGE.write_text(fill_in(PAGE.read_text()))
