"""Splats of the synthetic room without its ball, through the same writers; no tensor library."""

import numpy as np

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.splat_export.config import Config
from inpaint3d.stages.splat_export.export import write_splats
from inpaint3d.stages.splat_export.start import begin

MOST = 500


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """As exact depth places them, not fitted."""
    scene = synthetic_scene()
    seen = zip(scene.cameras, scene.empty_images, scene.empty_depths, strict=True)
    surfaces = [SurfaceView(camera, image, depth.astype(np.float32)) for camera, image, depth in seen]
    cloud = begin(surfaces, list(scene.empty_images), min(config.splats, MOST))
    outputs.write("splat-scene", write_splats(outputs.folder("splat-scene"), cloud, config.formats))
    ctx.progress(1, 1, "stub")
