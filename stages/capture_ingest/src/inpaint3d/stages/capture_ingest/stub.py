"""The synthetic room as a capture with known cameras and masks; the truth is the room without its ball."""

import numpy as np

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Capture, CapturedFrame, KnownCamera, Truth
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import write_mask, write_png
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.capture_ingest.config import Config

SIZE = (160, 120)


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Eight views with the ball and three without it."""
    scene = synthetic_scene(8, *SIZE)
    folder = outputs.folder("capture")
    frames = []
    for name, camera, image, mask in zip(scene.names, scene.cameras, scene.images, scene.object_masks, strict=True):
        write_png(folder / "frames" / f"{name}.png", image)
        write_mask(folder / "masks" / f"{name}.png", mask)
        frames.append(_make_frame(name, camera, mask=f"masks/{name}.png"))
    outputs.write("capture", Capture(layout="photos", ordered=True, frames=tuple(frames)))

    empty = synthetic_scene(3, *SIZE, arc_deg=70.0)
    folder = outputs.folder("truth")
    frames = []
    for i, (camera, image) in enumerate(zip(empty.cameras, empty.empty_images, strict=True)):
        name = f"truth_{i:03d}"
        write_png(folder / "frames" / f"{name}.png", np.asarray(image))
        frames.append(_make_frame(name, camera, mask=None))
    outputs.write("truth", Truth(frames=tuple(frames)))
    ctx.progress(1, 1, "stub")


def _make_frame(name: str, camera: Camera, mask: str | None) -> CapturedFrame:
    known = KnownCamera(
        model="PINHOLE", params=(camera.fx, camera.fy, camera.cx, camera.cy), world_from_cam=camera.pose
    )
    return CapturedFrame(
        name=name, path=f"frames/{name}.png", width=camera.width, height=camera.height, camera=known, mask=mask
    )
