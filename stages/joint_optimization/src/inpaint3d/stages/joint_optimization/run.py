"""Reconstruction outside the mask, a distilled prior inside (Inpaint3D, 'Joint Synthesis and Reconstruction')."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.artifacts import EffectPlan, MaskSet, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.context import Context, Inputs, Outputs
from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.low_rank import LowRankCopy
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.radiance import backends
from inpaint3d.radiance.artifact import write_views
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field, save_field
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.scene.image_io import read_exr
from inpaint3d.stages.joint_optimization.appearance import Recolour
from inpaint3d.stages.joint_optimization.batch import Filled
from inpaint3d.stages.joint_optimization.beforehand import (
    PictureGuide,
    ReferenceGuide,
    filled_classically,
    fixed_windows,
    sampled_views,
)
from inpaint3d.stages.joint_optimization.config import WITHOUT_GUIDE, Config, label_of
from inpaint3d.stages.joint_optimization.curves import Curves
from inpaint3d.stages.joint_optimization.decisions import decide
from inpaint3d.stages.joint_optimization.features import FeatureGuide
from inpaint3d.stages.joint_optimization.guidance import DatasetGuide, Guide, PriorGuide, evaluations
from inpaint3d.stages.joint_optimization.loop import Problem, optimise
from inpaint3d.stages.joint_optimization.parallel import Ranks, together
from inpaint3d.stages.joint_optimization.priors import load_denoiser
from inpaint3d.stages.joint_optimization.reference import completed
from inpaint3d.stages.joint_optimization.scene import SceneView, distillable, load_scene
from inpaint3d.stages.joint_optimization.shrink import shrunk

Views = tuple[SceneView, ...]


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The stage. Inputs and output are the ports of stage.yaml; nothing under a mask is ever read into a loss."""
    with together(config.ranks, solve, config, inputs, ctx) as ranks:
        problem, reasons, curves = solve(config, inputs, ctx, ranks)
    field, scene = problem.field, problem.scene
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
        label=label_of(config.estimator, continued=not problem.fresh),
        spec=field.spec,
        views=views,
        steps=config.steps,
        seed=ctx.seed,
        backend=backends.name_of(field.backend),
        held_out_psnr=curves.last_psnr,
        decisions=reasons,
        non_finite=ctx.non_finite,
    )
    outputs.write("radiance-field", metadata)


def solve(config: Config, inputs: Inputs, ctx: Context, ranks: Ranks) -> tuple[Problem, dict[str, str], Curves]:
    """Pose the problem and optimise: what every rank does alike."""
    torch.set_num_threads(max(1, ctx.threads // ranks.here))
    problem, reasons = pose(config, inputs, ctx.seed, ranks.device(ctx.device))
    if isinstance(problem.guide, PriorGuide) and (copy := problem.guide.copy) is not None:
        copy.optimiser.register_step_pre_hook(lambda *_: ranks.average(copy.parameters))
    curves = Curves()
    optimise(problem, ctx, curves, ranks)
    return problem, reasons, curves


def pose(config: Config, inputs: Inputs, seed: int, device: str) -> tuple[Problem, dict[str, str]]:
    """What is to be optimised, and what was decided about it, in words."""
    posed = inputs.one("posed-capture", PosedCapture)
    plan = inputs.one("effect-plan", EffectPlan).metadata
    scene = load_scene(posed, inputs.one("mask-set", MaskSet))
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
        spec,
        plan,
        carried_over=initial is not None,
        distils=config.estimator not in WITHOUT_GUIDE,
        diffuse_start=config.diffuse_start,
    )
    field = load_field(initial.path(initial.metadata.weights), spec) if initial else RadianceField(spec, seed)
    reasons, to_fill, filled = decisions.reasons, scene.train, None
    if config.estimator == "reference":
        to_fill, filled, reasons["hole"] = complete(scene.train, field, initial, config, seed, device)
    elif initial and config.estimator not in WITHOUT_GUIDE and config.hole == "unseen":
        to_fill, reasons["hole"] = shrink_holes(scene.train, initial, config.witnesses)
    guide = load_guide(config, inputs, to_fill, seed, device)
    if guide is not None:
        reasons["cost"] = cost_in_words(config)
    if config.estimator == "classical":
        scene = replace(scene, train=filled_classically(scene.train))
    problem = Problem(
        field=field.to(device),
        guide=guide,
        scene=scene,
        to_fill=to_fill,
        config=config,
        seed=seed,
        fresh=initial is None,
        diffuse_start=decisions.diffuse_start,
        filled=filled,
    )
    return problem, reasons


def complete(
    views: Views,
    field: RadianceField,
    initial: Artifact[RadianceFieldArtifact] | None,
    config: Config,
    seed: int,
    device: str,
) -> tuple[Views, Filled, str]:
    """The views with nothing missing in the mean appearance, what they show in the hole, and how that was done."""
    if initial is None:
        raise ConfigurationError(
            "estimator 'reference' carries pictures by the depth of a field of the known pixels; wire one to the input "
            "initial-field and set start: initial-field, or choose another estimator"
        )
    recolour = Recolour(field)
    made, words = completed(
        views,
        depth_maps(views, initial),
        recolour,
        witnesses=config.witnesses,
        references=config.reference_views,
        variety=config.variety,
        seed=seed,
    )
    alike = tuple(replace(one.view, image=one.picture) for one in made)
    own = tuple(replace(one.view, image=recolour.from_mean(one.picture, i)) for i, one in enumerate(made))
    surfaces = [(one.coarse.camera, one.coarse.depth, one.coarse.hole) for one in made]
    return alike, Filled(own, SightLines.of_surfaces(surfaces, device)), words


def shrink_holes(views: Views, initial: Artifact[RadianceFieldArtifact], witnesses: int) -> tuple[Views, str]:
    """The views with holes reduced to what other views do not show, and what that left, in words."""
    reduced = tuple(shrunk(views, depth_maps(views, initial), witnesses))
    if not distillable(reduced):
        return views, "as masked: other views show all that is behind it"
    before, after = (sum(int(v.hole.sum()) for v in some) for some in (views, reduced))
    return reduced, f"{after / before:.0%} of what is masked, which {witnesses} other views do not show"


def depth_maps(views: Views, initial: Artifact[RadianceFieldArtifact]) -> dict[str, NDArray[np.float32]]:
    """By view, where the initial field's light stops, as its artifact has it."""
    maps = {v.name: read_exr(initial.path(v.maps))["median.Z"] for v in initial.metadata.views}
    if missing := [v.name for v in views if v.name not in maps]:
        raise BadInputError(f"the initial field has no render of view {missing[0]}; it belongs to another capture")
    return maps


def load_guide(config: Config, inputs: Inputs, to_fill: Views, seed: int, device: str) -> Guide | None:
    """What fills the hole; None where nothing does."""
    if config.estimator in WITHOUT_GUIDE:
        return None
    if not distillable(to_fill):
        raise BadInputError(
            "no training view shows both the hole and something known around it, so that nothing can be told of it; "
            "author another mask, or set estimator: none"
        )
    if config.estimator == "features":
        return FeatureGuide(
            to_fill,
            size=config.feature_size,
            matching=config.matching,
            references=config.references,
            least_known=config.least_known,
        )
    if config.estimator == "reference":
        return ReferenceGuide([view.image for view in to_fill], config.feature_size)
    prior = load_denoiser(config, inputs, device)
    if config.estimator in ("inpaint-then-nerf", "dataset-update"):
        size, g = prior.size, config.guidance
        windows = fixed_windows(to_fill, size=size, span=config.span_first, least_known=config.least_known)
        if config.estimator == "dataset-update":
            return DatasetGuide(
                prior, windows, guidance=g, steps=config.denoise_steps, update_every=config.update_every
            )
        pictures = sampled_views(
            to_fill, windows, prior, steps=config.sample_steps, guidance=g, seed=seed, device=device
        )
        return PictureGuide(pictures, windows, size)
    copy = None
    if config.estimator == "vsd" and isinstance(prior, InpaintingPrior):
        copy = LowRankCopy(prior, rank=config.copy_rank, rate=config.copy_rate, seed=seed)
    return PriorGuide(prior, config.estimator, config.guidance, config.denoise_steps, copy)


def cost_in_words(config: Config) -> str:
    """UNet evaluations, for the artifact."""
    count = evaluations(config.estimator, guidance=config.guidance, steps=config.denoise_steps)
    match config.estimator:
        case "features" | "reference":
            return "no UNet evaluation"
        case "inpaint-then-nerf":
            each = config.sample_steps * (1 if config.guidance in (0.0, 1.0) else 2)
            return f"{each} UNet evaluations a view before the first step, none in a step"
        case "dataset-update":
            return f"{count} UNet evaluations at every {config.update_every}th distilled step of a view"
        case _:
            return f"{count} UNet evaluations a distilled step"
