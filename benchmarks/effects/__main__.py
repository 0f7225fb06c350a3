"""Are effects decided right, and does it pay? Captures of `captures.py`, fields of `fields.py`.

python -m benchmarks.effects [--only EFFECT] [--own] [--steps N]    fits, goes on where it was stopped, writes figures
"""

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.effects.captures import STRENGTHS, MadeCapture, PlanFolder, list_recipes, make
from benchmarks.effects.fields import plan_with, score
from benchmarks.effects.verdicts import chosen_by, judge

from inpaint3d.contracts.models.artifacts import Effect
from inpaint3d.scene.effects.evidence import Evidence
from inpaint3d.stages.scene_analysis.run import decide_effect, make_plan

CACHE = Path(".cache/effects")
OUT = Path("benchmarks/results/effects.json")
EFFECTS = tuple(STRENGTHS)
Row = dict[str, Any]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=EFFECTS, help="captures of one effect")
    parser.add_argument("--own", action="store_true", help="fields with all effects, and with those decided, later")
    parser.add_argument("--steps", type=int, default=200, help="of each fit")
    parser.add_argument("--rays", type=int, default=128, help="of each step")
    parser.add_argument("--cache", type=Path, default=CACHE, help="where captures are kept")
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    found: Row = json.loads(given.out.read_text()) if given.out.is_file() else {}
    settings = {"steps": given.steps, "rays": given.rays}
    rows: dict[str, Row] = found.get("captures", {}) if found.get("settings") == settings else {}
    recipes = [r for r in list_recipes() if given.only in (None, r.effect)]
    # First what decides who is right, for all captures; then what all effects together cost.
    for recipe, whole in [*((r, False) for r in recipes), *((r, True) for r in recipes if not given.own)]:
        made = make(recipe, given.cache / recipe.name)
        row = rows.setdefault(recipe.name, {"effect": recipe.effect, "strength": recipe.strength, "scores": {}})
        with tempfile.TemporaryDirectory() as scratch:
            measure(made, row, Path(scratch), given.steps, given.rays, whole=whole)
        given.out.write_text(json.dumps({"settings": settings, "captures": rows, **judge(rows)}, indent=1) + "\n")


def measure(made: MadeCapture, row: Row, scratch: Path, steps: int, rays: int, *, whole: bool) -> None:
    """Decide every effect; fit the fields not there yet: none on, the capture's own; whole: all, those decided."""
    evidence = Evidence.of(made.views, made.points, ordered=True)
    decided = [decide_effect(name, evidence, {}) for name in EFFECTS]
    row["found"] = {effect.name: describe(effect) for effect in decided}
    forced = [effect.model_copy(update={"state": "forced-on"}) for effect in decided]
    plan = PlanFolder(make_plan(forced, evidence, scratch), scratch)
    row["left_out"] = sorted({one.name for one in plan.metadata.ignored})
    combinations = ((), (made.recipe.effect,), *((EFFECTS, chosen_by(row)) if whole else ()))
    for on in dict.fromkeys(tuple(sorted(c)) for c in combinations):
        if "+".join(on) not in row["scores"]:
            work = scratch / "work"
            got = score(made, plan_with(plan, frozenset(on)), work, steps=steps, rays=rays)
            shutil.rmtree(work)
            row["scores"]["+".join(on)] = {"psnr": round(got.psnr, 3), "cpu_s": round(got.cpu_s, 2)}


def describe(effect: Effect) -> Row:
    """A decision with its two figures and their lower ends."""
    figures = {
        name: None if one is None else {"value": round(one.value, 4), "low": round(one.low, 4)}
        for name, one in (("size", effect.size), ("gain", effect.gain))
    }
    return {"state": effect.state, **figures}


if __name__ == "__main__":
    main()
