"""The synthetic scene's own object masks, through the same writers."""

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import PosedCapture, PosedTruth
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.synthetic import BALL_RADIUS
from inpaint3d.scene.volumes import sphere, volume_mask
from inpaint3d.stages.mask_authoring.authored import Authored, Names, write_mask_set
from inpaint3d.stages.mask_authoring.config import Config


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """A sphere where the synthetic scene has its ball; any request is taken as this one."""
    frames = inputs.one("posed-capture", PosedCapture).metadata.frames
    truth = inputs.optional("posed-truth", PosedTruth)
    truth_frames = truth.metadata.frames if truth else ()
    ball = sphere((0.0, 0.0, 0.0), 1.1 * BALL_RADIUS)
    authored = Authored(
        origin="sphere",
        method="stub: rays against a sphere",
        masks=[volume_mask(Camera.from_model(f), ball) for f in frames],
        truth_masks=[volume_mask(Camera.from_model(f), ball) for f in truth_frames],
        primitives=(ball,),
    )
    names = Names([f.name for f in frames], [f.name for f in truth_frames])
    outputs.write("mask-set", write_mask_set(outputs.folder("mask-set"), authored, names))
    ctx.progress(1, 1, "stub")
