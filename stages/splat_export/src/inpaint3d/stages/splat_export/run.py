"""Fit splats to the inpainted scene and write them."""

import numpy as np
import torch

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import (
    CompletedViews,
    EffectPlan,
    MaskSet,
    PosedCapture,
    RadianceFieldArtifact,
)
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rendering import render_view
from inpaint3d.radiance.splats import Splats, View, has_kernels, render_splats
from inpaint3d.radiance.surface_views import SurfaceView, close_off, surface_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.masked_views import load_masked_scene
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.stages.splat_export.cloud import SplatCloud
from inpaint3d.stages.splat_export.config import Config
from inpaint3d.stages.splat_export.export import write_splats
from inpaint3d.stages.splat_export.fidelity import measure_fidelity
from inpaint3d.stages.splat_export.fit import Schedule, fit
from inpaint3d.stages.splat_export.start import begin
from inpaint3d.stages.splat_export.targets import Target, load_targets


def run(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:
    """Place splats by the field's depth, fit them to photos and completed views, score and write them."""
    if not has_kernels():
        raise ConfigurationError("splats are drawn by compiled kernels; install a C++ compiler, then inpaint3d again")
    torch.set_num_threads(ctx.threads)
    inpainted, posed = inputs.one("inpainted", RadianceFieldArtifact), inputs.one("posed-capture", PosedCapture)
    masks, plan = inputs.one("mask-set", MaskSet), inputs.one("effect-plan", EffectPlan)
    completed = inputs.optional("completed-views", CompletedViews)
    scene = load_masked_scene(posed, masks, plan, whole_mask=True)
    field = load_field(inpainted.path(inpainted.metadata.weights), inpainted.metadata.spec).eval()
    total = config.steps + 2
    ctx.progress(0, total, "reading the views")
    targets = load_targets(scene.train, completed, field, config.block)
    surfaces = load_surfaces(inpainted, field, targets, config)
    cloud = begin(surfaces, [target.picture for target in targets], config.splats)
    ctx.progress(1, total, f"{len(cloud)} splats on what {len(surfaces)} views show")
    rate = config.position_rate * measure_pixel(surfaces)

    def tell(step: int, loss: float) -> None:
        ctx.record("fit", step=step, loss=loss)
        ctx.progress(step + 1, total, "fitting", loss=loss)

    cloud = fit(cloud, targets, Schedule(config.steps, rate, config.similarity, ctx.seed), tell)
    photos = choose_evenly(scene.test, config.held_out_views) if config.held_out_views else []
    fidelity = measure_fidelity(lambda camera: draw(cloud, camera), photos, inpainted.metadata.held_out_psnr)
    told = posed.metadata.scale
    provenance = {"posed-capture": posed.digest, "mask-set": masks.digest, "radiance-field": inpainted.digest}
    metadata = write_splats(
        outputs.folder("splat-scene"),
        cloud,
        config.formats,
        metres_per_unit=config.metres_per_unit or (told.metres_per_unit if told else None),
        provenance=provenance | ({"completed-views": completed.digest} if completed else {}),
        fidelity=fidelity,
    )
    outputs.write("splat-scene", metadata)
    found = f", {fidelity.psnr:.2f} dB on {fidelity.photos} held-out photos" if fidelity else ""
    ctx.progress(total, total, f"{metadata.splats} splats{found}")


def load_surfaces(
    artifact: Artifact[RadianceFieldArtifact], field: RadianceField, targets: list[Target], config: Config
) -> list[SurfaceView]:
    """The field's depth in every target's view, a dome behind it. BadInputError where no view shows a surface."""
    surfaces = [
        surface_view(
            artifact, target.name, target.camera, lambda camera: render_view(field, camera, block=config.block),
            longest_side=config.render_longest_side, opaque=config.opaque,
        )
        for target in targets
    ]  # fmt: skip
    if not any((surface.depth > 0).any() for surface in surfaces):
        raise BadInputError(
            f"the field '{artifact.metadata.label}' shows no surface in {len(surfaces)} views; train it longer"
        )
    return [close_off(surface) for surface in surfaces]


def measure_pixel(surfaces: list[SurfaceView]) -> float:
    """How wide a pixel of the depth is where the surfaces are, scene units; the median."""
    return float(np.median([np.median(surface.depth) / surface.camera.fx for surface in surfaces]))


def draw(cloud: SplatCloud, camera: Camera) -> Image:
    """The splats as a camera sees them [h, w, 3], in [0, 1]."""
    splats = Splats(**{name: torch.from_numpy(array) for name, array in cloud.arrays.items()})
    with torch.no_grad():
        return render_splats(splats, View.of(camera)).clamp(0, 1).numpy()
