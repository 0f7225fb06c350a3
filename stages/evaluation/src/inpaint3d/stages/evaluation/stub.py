"""A tiny valid evaluation of the synthetic room, through the same writers; no tensor library."""

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import Evaluation, PictureStrip, Protocol
from inpaint3d.scene.image_io import write_png
from inpaint3d.scene.psnr import psnr
from inpaint3d.scene.ssim import ssim
from inpaint3d.scene.synthetic import synthetic_scene
from inpaint3d.stages.evaluation.baselines import mean_surround
from inpaint3d.stages.evaluation.config import Config
from inpaint3d.stages.evaluation.pictures import GAP, colour_depth, hide_hole, set_side_by_side
from inpaint3d.stages.evaluation.scores import Scores

CONTACT = "pictures/before_mask_after_depth.png"
PROTOCOL = "bbox10-vgg"
CAPTIONS = ("before", "mask", "after (mean-surround)", "depth")


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    """Score the synthetic room's ball, replaced by the mean colour of its surround, against the room without it."""
    scene = synthetic_scene()
    folder = outputs.folder("evaluation")
    scores = Scores()
    filled = [mean_surround(image, mask, 2) for image, mask in zip(scene.images, scene.object_masks, strict=True)]
    for name, picture, truth in zip(scene.names, filled, scene.empty_images, strict=True):
        scores.add(PROTOCOL, "mean-surround", name, {"psnr": psnr(picture, truth), "ssim": ssim(picture, truth)})
    scores.write(folder / "per_view.csv")
    panels = [
        scene.images[0],
        hide_hole(scene.images[0], scene.object_masks[0]),
        filled[0],
        colour_depth(scene.empty_depths[0].astype("float32")),
    ]
    write_png(folder / CONTACT, set_side_by_side(panels))
    protocol = Protocol(
        name=PROTOCOL, description="Stub: whole views of the synthetic room.", metrics=tuple(scores.means(PROTOCOL))
    )
    outputs.write(
        "evaluation",
        Evaluation(
            protocols=(protocol,),
            pictures=(CONTACT,),
            contact=PictureStrip(view=scene.names[0], file=CONTACT, captions=CAPTIONS, gap=GAP),
            weaknesses=("This is a stub: nothing was learned.",),
        ),
    )
    ctx.progress(1, 1, "stub")
