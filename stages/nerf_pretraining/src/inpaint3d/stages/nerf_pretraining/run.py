"""Fit the paper's radiance field to a whole capture, and show every view of it."""

import numpy as np
import torch

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import EffectPlan, PosedCapture, RadianceFieldArtifact
from inpaint3d.radiance import backends
from inpaint3d.radiance.artifact import write_curve, write_views
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.held_out import HeldOut, KnownPhoto
from inpaint3d.radiance.io import save_field
from inpaint3d.radiance.line_of_sight import SightLines
from inpaint3d.radiance.sizing import field_spec
from inpaint3d.radiance.sparse_point_metrics import measure_sparse_points
from inpaint3d.radiance.training import Pixels
from inpaint3d.scene.capture_io import load_points, load_posed
from inpaint3d.scene.evidence_masks import IgnoredPixels
from inpaint3d.scene.plausibility import doubt_field, measure_baselines
from inpaint3d.stages.nerf_pretraining.config import Config
from inpaint3d.stages.nerf_pretraining.fit import Known, fit


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """The stage. Inputs and output are the ports of stage.yaml."""
    torch.set_num_threads(ctx.threads)
    posed = inputs.one("posed-capture", PosedCapture)
    plan = inputs.one("effect-plan", EffectPlan)
    views = load_posed(posed)
    train = [view for view in views if view.split == "train"]
    test = [view for view in views if view.split == "test"]
    if not train:
        raise BadInputError(f"none of the {len(views)} posed views is for training; re-run pose-estimation")

    points = load_points(posed.path(posed.metadata.points))
    spec = field_spec(
        config.architecture,
        plan.metadata,
        views=len(train),
        centre_depth=posed.metadata.centre_depth,
        points=points.xyz,
    )
    field = RadianceField(spec, ctx.seed).to(ctx.device)
    ignored = IgnoredPixels(plan)
    known = [ignored.take_from(view.valid(), view.name, view.camera) for view in train]
    pixels = Pixels.of([view.camera for view in train], [view.image() for view in train], known, ctx.device)
    if not len(pixels):
        raise BadInputError("no pixel of the training views is valid; re-run pose-estimation")
    seen_by_training = np.array([view.split == "train" for view in views])[points.track_frame]
    sight_lines = None
    if seen_by_training.any():
        sight_lines = SightLines.of([view.camera for view in views], points, seen_by_training, ctx.device)
    scored = HeldOut.on_lattice(map(KnownPhoto.of, test[: config.score_views]), config.score_side, ctx.device)
    shown = Known(pixels, sight_lines, [(view.name, view.camera) for view in train])
    curve = fit(field, shown, scored, config, ctx)

    folder = outputs.folder("radiance-field")
    save_field(folder / "weights.safetensors", field)
    write_curve(folder, curve)
    held_out = HeldOut.on_lattice(map(KnownPhoto.of, test), config.score_side, ctx.device)
    judges = ~seen_by_training if test else None
    agrees = measure_sparse_points(field, [view.camera for view in views], points, among=judges, block=config.block)
    psnr = held_out.psnr(field, config.block)
    depth_error, floaters = (None, None) if agrees is None else (agrees.depth_error, agrees.floaters)
    for doubt in doubt_field(psnr, measure_baselines(train, test, points), depth_error, floaters):
        ctx.doubt(doubt)
    pictures = write_views(
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
        views=pictures,
        steps=config.steps,
        seed=ctx.seed,
        backend=backends.name_of(field.backend),
        held_out_psnr=psnr,
        depth_error=depth_error,
        floaters=floaters,
        non_finite=ctx.non_finite,
        health=ctx.health,
    )
    outputs.write("radiance-field", metadata)
