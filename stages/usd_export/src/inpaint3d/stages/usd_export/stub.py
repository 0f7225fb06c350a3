"""A tiny valid USD scene of the synthetic room, through the same writers; no tensor library."""

import numpy as np

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.usd_export.config import Config
from inpaint3d.stages.usd_export.export import MaskVolume, make_content, write_scene
from inpaint3d.stages.usd_export.surface_views import SurfaceView

TINY = Config(grid=24, texture_size=512)
BOX = (np.array([-0.6, -0.6, -0.3]), np.array([0.6, 0.6, 0.6]))


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """The synthetic room without its ball as `inpainted`, with it as `original`, from exact depth."""
    scene = synthetic_scene()
    folder = outputs.folder("usd-scene")
    contents = []
    for name, images, depths in (
        ("inpainted", scene.empty_images, scene.empty_depths),
        ("original", scene.images, scene.depths),
    ):
        views = [
            SurfaceView(camera, image, depth.astype(np.float32))
            for camera, image, depth in zip(scene.cameras, images, depths, strict=True)
        ]
        contents.append(make_content(name, views, BOX, folder, TINY))
    mask = MaskVolume((), scene.cameras, list(scene.object_masks))
    outputs.write("usd-scene", write_scene(folder, contents, scene.names, scene.cameras, mask, None))
    ctx.progress(1, 1, "stub")
