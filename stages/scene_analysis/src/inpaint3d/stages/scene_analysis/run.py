"""Decide which capture effects a scene calls for, from its posed frames and sparse points."""

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import EffectPlan, PosedCapture
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.stages.scene_analysis.config import Config
from inpaint3d.stages.scene_analysis.decide import contraction, exposure, lens_distortion, view_dependence
from inpaint3d.stages.scene_analysis.photometry import observe


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """See the stage's README."""
    posed = inputs.one("posed-capture", PosedCapture)
    views, points = load_posed(posed), load_points(posed.path(posed.metadata.points))
    ctx.progress(0, 4, "reading colours along tracks")
    seen = observe(views, points)
    ctx.progress(2, 4, "gains of views")
    by_exposure, gains = exposure(views, seen, config)
    ctx.progress(3, 4, "view dependence")
    effects = (
        contraction(points, config),
        lens_distortion(posed.metadata.lens, config),
        by_exposure,
        view_dependence(views, points, seen, gains, config),
    )
    outputs.write("effect-plan", EffectPlan(effects=effects))
    for effect in effects:
        ctx.log(f"{effect.name}: {effect.state}; {effect.reason}")
    ctx.progress(4, 4, "effects decided")
