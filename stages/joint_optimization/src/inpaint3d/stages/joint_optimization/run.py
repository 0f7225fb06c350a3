"""Reconstruction outside the mask, a distilled prior inside (Inpaint3D, 'Joint Synthesis and Reconstruction')."""

import torch

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    CompletedViews,
    EffectPlan,
    MaskSet,
    PosedCapture,
    RadianceFieldArtifact,
)
from inpaint3d.radiance import backends
from inpaint3d.radiance.artifact import write_views
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field, save_field
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.scene.masked_views import load_masked_scene
from inpaint3d.stages.joint_optimization.config import Config
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.decisions import decide
from inpaint3d.stages.joint_optimization.estimators.base import Setting
from inpaint3d.stages.joint_optimization.guidance import PriorGuide
from inpaint3d.stages.joint_optimization.loop import optimise
from inpaint3d.stages.joint_optimization.parallel import Ranks, start_ranks
from inpaint3d.stages.joint_optimization.problem import Problem


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The stage. Inputs and output are the ports of stage.yaml; nothing under a mask is ever read into a loss."""
    with start_ranks(config.ranks, solve, config, inputs, ctx) as ranks:
        problem, reasons, curves = solve(config, inputs, ctx, ranks)
    field, scene = problem.field, problem.scene
    completed = inputs.optional("completed-views", CompletedViews)
    folder = outputs.folder("radiance-field")
    save_field(folder / "weights.safetensors", field)
    curves.write(folder)
    views = write_views(
        folder,
        field,
        [(v.name, v.camera) for v in (*scene.train, *scene.test)],
        longest_side=config.view_side,
        block=config.block,
        tick=lambda done, total: ctx.progress(done, total, "rendering views"),
    )
    metadata = RadianceFieldArtifact(
        label=config.estimator.label(
            continued=not problem.fresh, completion=completed.metadata.method if completed else None
        ),
        spec=field.spec,
        views=views,
        steps=config.steps,
        seed=ctx.seed,
        backend=backends.name_of(field.backend),
        held_out_psnr=curves.last_psnr,
        decisions=reasons,
        non_finite=ctx.non_finite,
        health=ctx.health,
    )
    outputs.write("radiance-field", metadata)


def solve(config: Config, inputs: Inputs, ctx: Context, ranks: Ranks) -> tuple[Problem, dict[str, str], Curves]:
    """Pose the problem and optimise: what every rank does alike."""
    torch.set_num_threads(max(1, ctx.threads // ranks.local_world_size))
    problem, reasons = pose(config, inputs, ctx.seed, ranks.device(ctx.device))
    if isinstance(problem.guide, PriorGuide) and (copy := problem.guide.copy) is not None:
        copy.optimiser.register_step_pre_hook(lambda *_: ranks.average(copy.parameters))
    curves = Curves()
    optimise(problem, ctx, curves, ranks)
    return problem, reasons, curves


def pose(config: Config, inputs: Inputs, seed: int, device: str) -> tuple[Problem, dict[str, str]]:
    """What is to be optimised, and what was decided about it, in words."""
    posed = inputs.one("posed-capture", PosedCapture)
    planned = inputs.one("effect-plan", EffectPlan)
    plan = planned.metadata
    scene = load_masked_scene(posed, inputs.one("mask-set", MaskSet), planned)
    initial = inputs.optional("initial-field", RadianceFieldArtifact) if config.start == "initial-field" else None
    if initial:
        spec = initial.metadata.spec
        field = load_field(initial.path(initial.metadata.weights), spec)
    else:
        spec = field_spec(
            config.architecture,
            plan,
            views=len(scene.train),
            centre_depth=posed.metadata.centre_depth,
            points=scene.points,
        )
        field = RadianceField(spec, seed)
    prepared = config.estimator.prepare(Setting(scene, field, initial, inputs, seed, device))
    decisions = decide(
        spec,
        plan,
        warm_start=initial is not None,
        distils=prepared.guide is not None,
        diffuse_first=config.estimator.diffuse_first,
    )
    problem = Problem(
        field=field.to(device),
        guide=prepared.guide,
        scene=scene,
        to_fill=prepared.to_fill,
        config=config,
        seed=seed,
        fresh=initial is None,
        diffuse_start=decisions.diffuse_start,
        filled=prepared.filled,
    )
    return problem, decisions.reasons | prepared.reasons
