"""Author masks: a volume, an object, a scribble, or masks that came with the capture; one mask for every view."""

from collections.abc import Sequence
from dataclasses import replace

import cv2

from inpaint3d.contracts.errors import ConfigurationError, WaitingError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    MaskRequest,
    MaskRequestArtifact,
    PosedCapture,
    PosedTruth,
    RadianceFieldArtifact,
    Segmenter,
)
from inpaint3d.contracts.models.artifacts.masks import ImportedRequest
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.plausibility import doubt_masks
from inpaint3d.stages.mask_authoring.author import author
from inpaint3d.stages.mask_authoring.authored import Authored, Names, write_mask_set
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.consistency import Agreement, measure_agreement
from inpaint3d.stages.mask_authoring.requests import example_request
from inpaint3d.stages.mask_authoring.sam import load_segmenter
from inpaint3d.stages.mask_authoring.scene import load_scene
from inpaint3d.stages.mask_authoring.shadow_masks import grow_by_shadows, look_for_shadows, report_shadows
from inpaint3d.stages.mask_authoring.unseen import find_unseen

TOO_MUCH = 0.95  # of all pixels masked: nothing is left to reconstruct the scene from


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """See the stage's README; ports and files are described in `stage.yaml` and `contracts.models.artifacts.masks`."""
    cv2.setNumThreads(ctx.threads)
    posed = inputs.one("posed-capture", PosedCapture)
    field = inputs.one("radiance-field", RadianceFieldArtifact)
    scene = load_scene(posed, field, inputs.optional("posed-truth", PosedTruth))
    if network := inputs.optional("segmenter", Segmenter):
        scene = replace(scene, segmenter=load_segmenter(network, ctx.threads))
    asked = inputs.optional("mask-request", MaskRequestArtifact)
    request = asked.metadata.request if asked else request_by_default(scene.views)
    authored = author(request.mask, scene, request.dilate, config, ctx)
    check(authored)
    shadows = look_for_shadows(scene, authored, config) if request.shadows else None
    # How well masks agree is a matter of the object: shadows are on the plane, by construction.
    outlines = authored.masks
    authored = authored if shadows is None else grow_by_shadows(authored, shadows, scene)
    check(authored)
    agreement = None if authored.primitives else measure_agreement(scene.depth_views, outlines, config.depth_tolerance)
    names = Names([v.name for v in scene.views], [v.name for v in scene.truth])
    report(authored, agreement, names.views, ctx)
    folder = outputs.folder("mask-set")
    # Around an outpainted scene other views show nothing by definition.
    hidden = None if authored.origin == "outpaint" else find_unseen(scene.depth_views, authored.masks)
    metadata = write_mask_set(folder, authored, names, agreement, hidden)
    hole = config.hole if hidden is not None else "object"
    more: dict[str, object] = {"hole": hole}
    if shadows is not None:
        more["shadows"] = report_shadows(folder, shadows, scene.depth_views, outlines, ctx)
    outputs.write("mask-set", metadata.model_copy(update=more))
    ctx.progress(1, 1, authored.method, share=authored.mean_share)


def report(authored: Authored, agreement: Agreement | None, names: Sequence[str], ctx: Context) -> None:
    """What speaks against the masks, and which views a person should look at."""
    consistency = agreement.set if agreement else None
    for doubt in doubt_masks(authored.mean_share, consistency, outside=authored.origin == "outpaint"):
        ctx.doubt(doubt)
    if agreement and (low := agreement.to_check(names)):
        ctx.log(
            f"look at the masks of {len(low)} of {len(names)} views, which agree little with their neighbours': "
            f"{', '.join(low)}"
        )


def request_by_default(views: list[View]) -> MaskRequest:
    """What a run without a request does: use the capture's own masks, or wait for a person."""
    if any(v.mask_path for v in views):
        return MaskRequest(mask=ImportedRequest(kind="imported"))
    raise WaitingError(
        f"no mask: the capture brings none and none was asked for. Write a request such as\n\n"
        f"{example_request(views[0])}\n\nto a file and run again with --mask FILE. "
        "Other kinds: sphere, box, scribble, outpaint, imported, union, difference, objects"
    )


def check(authored: Authored) -> None:
    """ConfigurationError for a mask that is nowhere, or everywhere."""
    drawn = "the capture's own masks" if authored.origin == "imported" else "the mask request"
    if not any(m.any() for m in authored.masks):
        raise ConfigurationError(
            f"the {authored.origin} mask is in none of the {len(authored.masks)} views; move or enlarge it in {drawn}"
        )
    if authored.mean_share > TOO_MUCH:
        raise ConfigurationError(
            f"the {authored.origin} mask covers {authored.mean_share:.1%} of the views' pixels (at most {TOO_MUCH:.0%} "
            f"can work); make it smaller in {drawn} (an outpainting sphere larger)"
        )
