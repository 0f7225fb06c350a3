"""What the synthetic room calls for: nothing. It is bounded, Lambertian, and pictured by an ideal camera."""

from typing import get_args

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Effect, EffectPlan
from inpaint3d.contracts.models.artifacts.effects import EffectName
from inpaint3d.stages.scene_analysis.config import Config


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Every effect off, or as forced."""
    effects = []
    for name in get_args(EffectName):
        forced = config.force.get(name)
        state = "off" if forced is None else "forced-on" if forced else "forced-off"
        effects.append(Effect(name=name, state=state, evidence={}, reason="stub: nothing measured", cost_ratio=1.0))
    outputs.write("effect-plan", EffectPlan(effects=tuple(effects)))
    ctx.progress(1, 1, "stub")
