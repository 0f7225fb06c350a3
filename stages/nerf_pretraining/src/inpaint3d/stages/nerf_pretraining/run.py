"""Fit the paper's radiance field to a whole capture, and show every view of it."""

import math

import numpy as np
import torch

from inpaint3d.contracts.artifacts import EffectPlan, FieldSpec, GridSpec, PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.context import Context, Inputs, Outputs
from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance import backends
from inpaint3d.radiance.architecture import planned_spec
from inpaint3d.radiance.artifact import write_curve, write_views
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import save_field
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.stages.nerf_pretraining.config import Architecture, Config
from inpaint3d.stages.nerf_pretraining.fit import fit
from inpaint3d.stages.nerf_pretraining.held_out import HeldOut

# Without contraction, the share of sparse points that the cube holds, and its margin: outliers must not blow it up.
POINTS_INSIDE, CUBE_MARGIN = 99.0, 1.1


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The stage. Inputs and output are the ports of stage.yaml."""
    torch.set_num_threads(ctx.threads)
    posed = inputs.one("posed-capture", PosedCapture)
    plan = inputs.one("effect-plan", EffectPlan).metadata
    views = load_posed(posed)
    train = [view for view in views if view.split == "train"]
    test = [view for view in views if view.split == "test"]
    if not train:
        raise BadInputError(f"none of the {len(views)} posed views is for training; re-run pose-estimation")

    spec = field_spec(config.architecture, posed, plan, len(train))
    field = RadianceField(spec, ctx.seed).to(ctx.device)
    pixels = Pixels.of(
        [view.camera for view in train], [view.image() for view in train], [view.valid() for view in train], ctx.device
    )
    if not len(pixels):
        raise BadInputError("no pixel of the training views is valid; re-run pose-estimation")
    curve = fit(field, pixels, HeldOut(test[: config.score_views], config.score_side, ctx.device), config, ctx)

    folder = outputs.folder("radiance-field")
    save_field(folder / "weights.safetensors", field)
    write_curve(folder, curve)
    score = HeldOut(test, config.view_side, ctx.device).psnr(field, config.block)
    shown = write_views(
        folder,
        field,
        [(view.name, view.camera) for view in views],
        longest_side=config.view_side,
        block=config.block,
        tick=lambda done, total: ctx.progress(done, total, "rendering views"),
    )
    metadata = RadianceFieldArtifact(
        label="pretrained",
        spec=spec,
        views=shown,
        steps=config.steps,
        seed=ctx.seed,
        backend=backends.name_of(field.backend),
        held_out_psnr=None if math.isnan(score) else score,
        non_finite=ctx.non_finite,
    )
    outputs.write("radiance-field", metadata)


def field_spec(size: Architecture, posed: Artifact[PosedCapture], plan: EffectPlan, views: int) -> FieldSpec:
    """The field that the parameters size and the effect plan shapes."""
    proposal = GridSpec(
        levels=size.proposal_levels,
        coarsest=size.coarsest,
        finest=size.proposal_finest,
        log2_table=size.proposal_log2_table,
        channels=1,
    )
    grid = GridSpec(
        levels=size.levels,
        coarsest=size.coarsest,
        finest=size.finest,
        log2_table=size.log2_table,
        channels=size.channels,
    )
    largest = FieldSpec(
        proposal_grid=proposal,
        proposal_samples=size.proposal_samples,
        grid=grid,
        samples=size.samples,
        density_width=size.density_width,
        bottleneck=size.bottleneck,
        view_width=size.view_width,
        view_layers=size.view_layers,
        glo=size.glo,
        far=size.far,
    )
    return planned_spec(
        largest,
        plan,
        views=views,
        centre_depth=posed.metadata.centre_depth,
        near_share=size.near_share,
        bound=1.0 if plan.active("contraction") else cube_half_side(posed),
    )


def cube_half_side(posed: Artifact[PosedCapture]) -> float:
    """Half side, in scene units, of the cube round the origin that holds the cameras and the sparse points."""
    xyz = load_points(posed.path(posed.metadata.points)).xyz
    reach = float(np.percentile(np.abs(xyz).max(-1), POINTS_INSIDE)) if len(xyz) else 1.0
    return CUBE_MARGIN * max(1.0, reach)
