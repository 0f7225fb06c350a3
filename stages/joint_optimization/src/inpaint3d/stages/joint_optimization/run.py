"""Reconstruction outside the mask, a distilled prior inside (Inpaint3D, 'Joint Synthesis and Reconstruction')."""

import time

import numpy as np
import torch

from inpaint3d.contracts.artifacts import DiffusionPrior, EffectPlan, MaskSet, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.context import Context, Inputs, Outputs
from inpaint3d.contracts.errors import BadInputError, ConfigurationError, InterruptedRun
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.io import load_prior
from inpaint3d.radiance import backends
from inpaint3d.radiance.artifact import write_views
from inpaint3d.radiance.checkpoints import load_checkpoint, save_checkpoint
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field, save_field
from inpaint3d.radiance.optim import learning_rate, make_optimizer
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.training import descend, proposal_anneal
from inpaint3d.scene.image_io import read_exr
from inpaint3d.stages.joint_optimization.batch import RayBank
from inpaint3d.stages.joint_optimization.config import Config, label_of
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.decisions import decide
from inpaint3d.stages.joint_optimization.distil import Distilled, distil
from inpaint3d.stages.joint_optimization.guidance import Guide
from inpaint3d.stages.joint_optimization.held_out import HeldOut
from inpaint3d.stages.joint_optimization.objective import decay_term, gradient_norms, step_terms
from inpaint3d.stages.joint_optimization.patches import Window, centre_views, draw_window
from inpaint3d.stages.joint_optimization.scene import Scene, SceneView, distillable, load_scene
from inpaint3d.stages.joint_optimization.schedule import (
    TimestepRange,
    centre_views_only,
    distillation_weight,
    specular_scale,
    terms_due,
    timestep_range,
    window_span,
)
from inpaint3d.stages.joint_optimization.shrink import shrunk

CHECKPOINT_INTERVAL_S = 30.0
Views = tuple[SceneView, ...]


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The stage. Inputs and output are the ports of stage.yaml; nothing under a mask is ever read into a loss."""
    torch.set_num_threads(ctx.threads)
    posed = inputs.one("posed-capture", PosedCapture)
    plan = inputs.one("effect-plan", EffectPlan).metadata
    scene = load_scene(posed, inputs.one("mask-set", MaskSet))
    guide = load_guide(config, inputs, scene, ctx)
    wired = inputs.optional("initial-field", RadianceFieldArtifact)
    initial = wired if config.start == "initial-field" else None
    spec = (
        initial.metadata.spec
        if initial
        else field_spec(
            config.architecture,
            plan,
            views=len(scene.train),
            centre_depth=posed.metadata.centre_depth,
            points=scene.points,
        )
    )
    decisions = decide(
        spec, plan, carried_over=initial is not None, distils=guide is not None, diffuse_start=config.diffuse_start
    )
    field = load_field(initial.path(initial.metadata.weights), spec) if initial else RadianceField(spec, ctx.seed)
    field = field.to(ctx.device)
    to_fill = scene.train
    if initial and guide is not None and config.hole == "unseen":
        to_fill, decisions.reasons["hole"] = shrink_holes(scene.train, initial, config.witnesses)
    curves = Curves()
    optimise(
        field, guide, scene, to_fill, config, ctx, curves, fresh=initial is None, diffuse_start=decisions.diffuse_start
    )
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
        label=label_of(config.estimator, continued=initial is not None),
        spec=spec,
        views=views,
        steps=config.steps,
        seed=ctx.seed,
        backend=backends.name_of(field.backend),
        held_out_psnr=curves.last_psnr,
        decisions=decisions.reasons,
        non_finite=ctx.non_finite,
    )
    outputs.write("radiance-field", metadata)


def shrink_holes(views: Views, initial: Artifact[RadianceFieldArtifact], witnesses: int) -> tuple[Views, str]:
    """The views with holes reduced to what other views do not show, and what that left, in words."""
    maps = {v.name: read_exr(initial.path(v.maps))["median.Z"] for v in initial.metadata.views}
    if missing := [v.name for v in views if v.name not in maps]:
        raise BadInputError(f"the initial field has no render of view {missing[0]}; it belongs to another capture")
    reduced = tuple(shrunk(views, maps, witnesses))
    if not distillable(reduced):
        return views, "as masked: other views show all that is behind it"
    before, after = (sum(int(v.hole.sum()) for v in some) for some in (views, reduced))
    return reduced, f"{after / before:.0%} of what is masked, which {witnesses} other views do not show"


def load_guide(config: Config, inputs: Inputs, scene: Scene, ctx: Context) -> Guide | None:
    """The prior with its estimator; None where the estimator is `none`."""
    if config.estimator == "none":
        return None
    prior = inputs.optional("diffusion-prior", DiffusionPrior)
    if prior is None:
        raise ConfigurationError(
            f"estimator {config.estimator!r} needs an artifact at the input diffusion-prior; "
            "wire one, or set estimator: none"
        )
    if not distillable(scene.train):
        raise BadInputError(
            "no training view shows both the hole and something known around it, so that a prior has nothing to fill; "
            "author another mask, or set estimator: none"
        )
    network = load_prior(prior.path(prior.metadata.weights), prior.metadata.spec).to(ctx.device)
    return Guide(network, config.estimator, config.guidance, config.denoise_steps)


def optimise(
    field: RadianceField,
    guide: Guide | None,
    scene: Scene,
    to_fill: Views,
    config: Config,
    ctx: Context,
    curves: Curves,
    *,
    fresh: bool,
    diffuse_start: bool,
) -> None:
    """The paper's loop; a field that is not fresh needs no reconstruction-only start (S7).

    to_fill: the training views with the holes that the prior is to fill.

    Interrupted, it leaves a checkpoint from which the next call goes on exactly.
    """
    bank = RayBank(scene.train, ctx.device)
    held_out = HeldOut(scene.test, config.score_pixels, ctx.device)
    optimizer = make_optimizer(
        field,
        network_scale=config.network_rate_share,
        hash_decay=config.hash_decay_weight,
        sparse=config.sparse_adam,
    )
    generator = torch.Generator().manual_seed(ctx.seed)
    warmup = config.warmup_steps if fresh else 0
    schedule = config.schedule_steps or config.steps
    checkpoint = ctx.work / "checkpoint.safetensors"
    if (kept := load_checkpoint(checkpoint, field, optimizer, generator)) is not None:
        curves.restore(kept)
    saved = time.monotonic()
    rays_a_step = config.rays + config.depth_patches * config.depth_patch_size**2
    while (step := optimizer.steps) < config.steps:
        try:
            ctx.progress(step, config.steps, "optimising")
        except InterruptedRun:
            save_checkpoint(checkpoint, field, optimizer, generator, curves.tensors())
            raise
        since = step - warmup
        timesteps = timestep_range(
            step, schedule, t_min=config.t_min, t_max=config.t_max, width=config.t_width, floor=config.t_floor
        )
        weight, span, specular, distilled = 0.0, config.span_first, 1.0, None
        if guide is not None and since >= 0 and since % config.distill_every == 0:
            total = config.steps - warmup
            weight = distillation_weight(
                since, total, peak=config.weight, warmup=config.weight_warmup, decay_to=config.weight_decay_to
            )
            span = window_span(since, total, first=config.span_first, last=config.span_last)
            specular = specular_scale(step, schedule) if diffuse_start else 1.0
            # Windows come from the step's own seed, not from a stream: a resumed run draws the same.
            window = choose_window(
                to_fill, guide, config, since=since, span=span, rng=np.random.default_rng((ctx.seed, step))
            )
            distilled = distil(
                field,
                guide,
                to_fill[window.view],
                window,
                timesteps=timesteps[:2],
                specular_scale=specular,
                block=config.block,
                generator=generator,
            )
        batch = bank.draw(
            config.rays, patches=config.depth_patches, patch_size=config.depth_patch_size, generator=generator
        )
        anneal = proposal_anneal(step, config.proposal_anneal_steps) if fresh else 1.0
        terms = step_terms(field, batch, distilled, weight, config, anneal=anneal, generator=generator)
        last = step + 1 == config.steps
        due = terms_due(step, -1 if guide is None else since, config.terms_every, config.distill_every)
        norms = gradient_norms(field, terms | decay_term(field, config)) if last or due else None
        rate = learning_rate(
            step,
            initial=config.learning_rate,
            final=config.final_learning_rate,
            steps=config.learning_rate_steps or config.steps,
            warmup=config.learning_rate_warmup,
        )
        losses = descend(field, optimizer, terms, rate, ctx.non_finite)
        if norms is not None:
            figures = {} if distilled is None else prior_figures(distilled, timesteps, weight, span, specular)
            curves.add_terms(step + 1, losses, norms, **figures)
        if last or (step + 1) % config.score_every == 0:
            psnr = held_out.psnr(field, config.block)
            loss = sum(value for name, value in losses.items() if name != "distillation")
            curves.add_point(step + 1, (step + 1) * rays_a_step, loss, psnr)
            ctx.record("learning_curve", step=step + 1, loss=loss, **({} if psnr is None else {"psnr": psnr}))
        if time.monotonic() - saved > CHECKPOINT_INTERVAL_S:
            save_checkpoint(checkpoint, field, optimizer, generator, curves.tensors())
            saved = time.monotonic()


def choose_window(
    shown: Views, guide: Guide, config: Config, *, since: int, span: float, rng: np.random.Generator
) -> Window:
    """A view that shows the hole (a centre view at first, S8) and a window of it."""
    views = distillable(shown)
    if centre_views_only(since, config.centre_steps):
        centres = np.stack([shown[i].camera.centre for i in views])
        shares = np.array([shown[i].hole_share for i in views])
        views = [views[i] for i in centre_views(centres, shares, config.centre_views)]
    chosen = views[int(rng.integers(len(views)))]
    view = shown[chosen]
    window = draw_window(
        view.hole, view.known, chosen, size=guide.prior.spec.size, span=span, least_known=config.least_known, rng=rng
    )
    if window is None:
        raise BadInputError(f"view {view.name} has no hole to fill; re-run mask-authoring")
    return window


def prior_figures(
    distilled: Distilled, timesteps: TimestepRange, weight: float, span: float, specular: float
) -> dict[str, float]:
    """How and how strongly the prior pushed at a step, for terms.csv."""
    return {
        "weight": weight,
        "t": distilled.t,
        "t_low": timesteps.low,
        "t_high": timesteps.high,
        "t_floored": float(timesteps.floored),
        "push": distilled.push,
        "window_span": span,
        "specular_scale": specular,
    }
