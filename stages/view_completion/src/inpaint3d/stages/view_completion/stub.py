"""The synthetic room without its ball, as if other photos had shown it, through the same writers."""

import numpy as np

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.view_completion.completion import Completion, write_completions
from inpaint3d.stages.view_completion.config import Config


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Pictures and depths of the empty room are true."""
    scene = synthetic_scene()
    made = [
        Completion(name, picture, np.where(hole, FIRST_PHOTO, 0).astype(np.uint16), depth.astype(np.float32))
        for name, picture, hole, depth in zip(
            scene.names, scene.empty_images, scene.object_masks, scene.empty_depths, strict=True
        )
    ]
    folder = outputs.folder("completed-views")
    metadata = write_completions(folder, made, method=config.method.name, summary="stub: the empty room")
    outputs.write("completed-views", metadata)
    ctx.progress(1, 1, "stub")
