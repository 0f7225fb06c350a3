"""What the synthetic room calls for: nothing. It is bounded, Lambertian, and pictured by an ideal camera."""

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import EffectPlan
from inpaint3d.scene.effects import load
from inpaint3d.scene.effects.description import Finding, decide
from inpaint3d.stages.scene_analysis.config import NAMES, Config


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Every effect off, or as forced."""
    nothing = Finding("stub: nothing measured")
    effects = tuple(decide(load(name).EFFECT, nothing, config.force) for name in NAMES)
    outputs.write("effect-plan", EffectPlan(effects=effects))
    ctx.progress(1, 1, "stub")
