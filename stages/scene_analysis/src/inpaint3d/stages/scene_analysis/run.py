"""Decide which capture effects a scene calls for, from its posed frames and sparse points."""

from collections.abc import Sequence
from pathlib import Path

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Effect, EffectPlan, PosedCapture
from inpaint3d.contracts.models.artifacts.effects import IgnoredFrame
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.scene.effects import blur, load, transients
from inpaint3d.scene.effects.description import Forced, decide
from inpaint3d.scene.effects.evidence import Evidence
from inpaint3d.scene.evidence_masks import write_ignored
from inpaint3d.stages.scene_analysis.config import NAMES, Config
from inpaint3d.stages.scene_analysis.costs import measure_costs


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """See the stage's README."""
    posed = inputs.one("posed-capture", PosedCapture)
    total = len(NAMES) + 2
    ctx.progress(0, total, "reading what views show along tracks")
    points = load_points(posed.path(posed.metadata.points))
    evidence = Evidence.of(load_posed(posed), points, ordered=posed.metadata.ordered)
    effects: list[Effect] = [] if posed.metadata.lens_effect is None else [posed.metadata.lens_effect]
    for name in NAMES:
        ctx.progress(NAMES.index(name) + 1, total, name)
        effects.append(decide_effect(name, evidence, config.force))
    outputs.write("effect-plan", make_plan(effects, evidence, outputs.folder("effect-plan")))
    for effect in effects:
        ctx.log(f"{effect.name}: {effect.state}; {effect.reason}")
    ctx.progress(total - 1, total, "what effects cost")
    for row in measure_costs(points.xyz, len(evidence.views), config.probe_steps, ctx.threads, ctx.seed):
        ctx.record("effect-costs", **row)
    ctx.progress(total, total, "effects decided")


def decide_effect(name: str, evidence: Evidence, forced: Forced) -> Effect:
    """Measure one effect and decide it."""
    module = load(name)
    return decide(module.EFFECT, module.measure(evidence), forced)


def make_plan(effects: Sequence[Effect], evidence: Evidence, folder: Path) -> EffectPlan:
    """The plan, and in its folder the masks of what effects that are on take out of the evidence."""
    plan = EffectPlan(effects=tuple(effects))
    ignored: list[IgnoredFrame] = []
    if plan.active("blur"):
        ignored += [IgnoredFrame(name=name, effect="blur") for name in blur.find_blurred(evidence)]
    if plan.active("transients"):
        ignored += write_ignored(folder, "transients", transients.mask_transients(evidence))
    return plan.model_copy(update={"ignored": tuple(ignored)})
