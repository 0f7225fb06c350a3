"""Every training view with its hole filled, before a field is fitted to them."""

from collections.abc import Mapping, Sequence

import torch

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    Contradiction,
    EffectPlan,
    MaskSet,
    PaintedViews,
    PosedCapture,
    RadianceFieldArtifact,
)
from inpaint3d.contracts.models.artifacts import Painting as PaintingRecord
from inpaint3d.contracts.store import Artifact
from inpaint3d.diffusion.loading import load_denoiser
from inpaint3d.radiance.appearance import AppearanceMap
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field
from inpaint3d.scene.masked_views import MaskedView, find_fillable, load_masked_scene
from inpaint3d.scene.paintings import Painting, read_painting, reduce_painting
from inpaint3d.scene.plausibility import CompletedHole, doubt_completion, measure_completions
from inpaint3d.scene.visibility import load_depth_maps, shrink_holes
from inpaint3d.stages.view_completion.classical import complete_classically
from inpaint3d.stages.view_completion.completion import Completion, write_completions
from inpaint3d.stages.view_completion.config import Classical, Config, PhotoCompletion, PriorSamples
from inpaint3d.stages.view_completion.photo_completion import complete_from_photos
from inpaint3d.stages.view_completion.prior_samples import complete_by_samples

Views = tuple[MaskedView, ...]


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The stage. Inputs and output are the ports of stage.yaml; nothing under a mask is ever looked at."""
    torch.set_num_threads(ctx.threads)
    plan = inputs.one("effect-plan", EffectPlan)
    posed, masks = inputs.one("posed-capture", PosedCapture), inputs.one("mask-set", MaskSet)
    # All of the mask, also where less is to be fitted: the rest would be black, and pictures and plates show it.
    scene = load_masked_scene(posed, masks, plan, whole_frames=False, whole_mask=True)
    field = inputs.one("radiance-field", RadianceFieldArtifact)
    if not find_fillable(scene.train):
        raise BadInputError(
            "no training view shows both the hole and something known around it, so that nothing can be told of it; "
            "author another mask"
        )
    references: list[str] = []
    paintings: dict[str, Painting] = {}
    contradictions: list[Contradiction] = []
    match config.method:
        case PhotoCompletion() as method:
            paintings = load_paintings(inputs.optional("painted-views", PaintedViews), scene.train)
            for name, painting in paintings.items():
                if painting.ignored:
                    ctx.log(f"{name}: {painting.ignored:.1%} of what was painted lies outside the mask, and is ignored")
            made, summary, references, contradictions = complete_from_photos(
                scene.train,
                load_depth_maps(scene.train, field),
                scene.points,
                AppearanceMap(_load_appearance(field, inputs)),
                method,
                seed=ctx.seed,
                paintings=paintings,
                device=ctx.device,
                tick=ctx.progress,
            )
        case Classical():
            ctx.progress(0, 1, "inpainting every view")
            made, summary = complete_classically(scene.train), "every view on its own, by Telea's method"
        case PriorSamples() as method:
            made, summary = _sample(method, scene.train, field, inputs, ctx)
    for doubt in doubt_completion(measure_completions(_collect_holes(made, scene.train))):
        ctx.doubt(doubt)
    folder = outputs.folder("completed-views")
    metadata = write_completions(folder, made, method=config.method.name, summary=summary, reference_views=references)
    found = {"paintings": _describe_paintings(paintings, scene.train), "contradictions": tuple(contradictions)}
    outputs.write("completed-views", metadata.model_copy(update=found))
    ctx.progress(1, 1, "completed")


def _collect_holes(made: Sequence[Completion], views: Views) -> list[CompletedHole]:
    cameras = {view.name: view.camera for view in views}
    return [
        CompletedHole.of(cameras[one.name], one.picture, one.depth, one.sources > 0)
        for one in made
        if one.depth is not None
    ]


def _load_appearance(field: Artifact[RadianceFieldArtifact], inputs: Inputs) -> RadianceField | None:
    """The field whose appearance codes tell exposures apart; None where the plan has exposure off."""
    if not inputs.one("effect-plan", EffectPlan).metadata.active("exposure"):
        return None
    return load_field(field.path(field.metadata.weights), field.metadata.spec)


def load_paintings(painted: Artifact[PaintedViews] | None, views: Views) -> dict[str, Painting]:
    """What somebody painted, by view, at the views' size. BadInputError for a view that is not of this capture, or a
    picture of another shape.
    """
    if painted is None:
        return {}
    by_name = {v.name: v for v in views}
    paintings: dict[str, Painting] = {}
    for one in painted.metadata.views:
        if (view := by_name.get(one.name)) is None:
            raise BadInputError(
                f"painted view {one.name} is no training view of this capture; there are {', '.join(by_name)}"
            )
        size = (view.camera.width, view.camera.height)
        paintings[one.name] = reduce_painting(read_painting(painted, one), one.name, *size)
    return paintings


def _describe_paintings(paintings: Mapping[str, Painting], views: Views) -> tuple[PaintingRecord, ...]:
    holes = {v.name: v.hole for v in views}
    return tuple(
        PaintingRecord(
            name=name,
            painted=round(float((p.mask & holes[name]).sum() / max(1, holes[name].sum())), 6),
            ignored=round(p.ignored, 6),
        )
        for name, p in paintings.items()
    )


def _sample(
    method: PriorSamples, views: Views, field: Artifact[RadianceFieldArtifact], inputs: Inputs, ctx: Context
) -> tuple[list[Completion], str]:
    to_fill, words = views, "what is masked"
    if method.hole == "unseen":
        reduced = tuple(shrink_holes(views, load_depth_maps(views, field), method.min_supporting_views))
        if find_fillable(reduced):
            to_fill, words = reduced, f"what {method.min_supporting_views} other views do not show"
    prior = load_denoiser(inputs, asker="method 'prior-samples'", prompt=method.prompt, device=ctx.device)
    made = complete_by_samples(to_fill, prior, method, seed=ctx.seed, device=ctx.device, tick=ctx.progress)
    return made, f"{words}, each view sampled from the prior on its own with one seed"
