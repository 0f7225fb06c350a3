"""A tiny valid USD scene of the synthetic room, through the same writers; no tensor library."""

import numpy as np

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.usd_export.config import Config
from inpaint3d.stages.usd_export.export import Capture, MaskVolume, make_content, write_scene
from inpaint3d.stages.usd_export.surface import bounds_of
from inpaint3d.stages.usd_export.texture import Picture

TINY = Config(grid=24, texture_size=256, triangles=400)


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """The synthetic room without its ball as `inpainted`, with it as `original`, from exact depth."""
    scene = synthetic_scene()
    folder = outputs.folder("usd-scene")
    made = []
    box = None
    for name, images, depths in (
        ("inpainted", scene.empty_images, scene.empty_depths),
        ("original", scene.images, scene.depths),
    ):
        seen = zip(scene.cameras, images, depths, scene.object_masks, strict=True)
        views, pictures = [], []
        for camera, image, depth, mask in seen:
            views.append(SurfaceView(camera, image, depth.astype(np.float32)))
            pictures.append(Picture(camera, image, np.ones_like(mask), mask))
        box = box or bounds_of(views)
        made.append(make_content(name, views, pictures, box, folder, TINY))
    mask = MaskVolume((), scene.cameras, list(scene.object_masks))
    capture = Capture(scene.names, scene.cameras, scene.points, None, {})
    outputs.write("usd-scene", write_scene(folder, made, capture, mask))
    ctx.progress(1, 1, "stub")
