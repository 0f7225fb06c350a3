"""A tiny valid prior without a tensor library: untrained weights, which denoise a Gaussian about the smooth fill."""

import numpy as np
from safetensors.numpy import save_file

from inpaint3d.contracts.kit.context import Context, Inputs, Outputs
from inpaint3d.contracts.models.artifacts import DiffusionPrior, MaskSet, PosedCapture, PriorSpec
from inpaint3d.scene.image_io import write_png
from inpaint3d.stages.diffusion_training.config import Config

STUB_SPEC = PriorSpec(
    size=16,
    width=8,
    multipliers=(1,),
    blocks=(1,),
    attention=(False,),
    packing=2,
    condition="mask-channel",
    known="clean",
    loss_region="hole",
    prediction="residual",
    residual_bands=(0.1, 0.25, 0.6, 1.3),
)
_EMBEDDING = 128


def stub(config: Config, inputs: Inputs, outputs: Outputs, ctx: Context) -> None:  # noqa: ARG001 - the shim's signature
    inputs.one("posed-capture", PosedCapture)
    inputs.one("mask-set", MaskSet)
    ctx.progress(0, 1, "stub")
    folder = outputs.folder("diffusion-prior")
    save_file(stub_weights(), folder / "weights.safetensors")
    (folder / "training_curve.csv").write_text("step,loss,held_out_loss\n0,1,1\n")
    write_png(folder / "samples" / "held_out.png", np.full((16, 64, 3), 128, np.uint8))
    outputs.write(
        "diffusion-prior",
        DiffusionPrior(
            spec=STUB_SPEC, samples=("samples/held_out.png",), steps=0, seed=ctx.seed, trained_on="nothing: a stub"
        ),
    )
    ctx.progress(1, 1, "stub")


def stub_weights() -> dict[str, np.ndarray]:
    """Zeros of the layout of `STUB_SPEC` (norms: ones); a network that outputs 0."""
    width, features = STUB_SPEC.width, 4 * _EMBEDDING
    pixels = STUB_SPEC.packing**2
    layers: dict[str, tuple[int, ...]] = {
        "noise.network.0": (features, _EMBEDDING),
        "noise.network.2": (features, features),
        "stem": (width, 7 * pixels, 3, 3),
        "levels.down": (width, width, 3, 3),
        "levels.up": (4 * width, width, 1, 1),
        "head": (3 * pixels, width, 3, 3),
        "levels.up_blocks.0.shortcut": (width, 2 * width, 1, 1),
    }
    norms = {"norm": width}
    for side, inner in (("down", width), ("up", 2 * width)):
        block = f"levels.{side}_blocks.0"
        layers[f"{block}.conv_in"] = (width, inner, 3, 3)
        layers[f"{block}.conv_out"] = (width, width, 3, 3)
        layers[f"{block}.modulation"] = (2 * width, features)
        norms |= {f"{block}.norm_in": inner, f"{block}.norm_out": width}
    weights = {f"network.{name}.weight": np.zeros(shape, np.float32) for name, shape in layers.items()}
    weights |= {f"network.{name}.bias": np.zeros(shape[0], np.float32) for name, shape in layers.items()}
    weights |= {f"network.{name}.weight": np.ones(width, np.float32) for name, width in norms.items()}
    return weights | {f"network.{name}.bias": np.zeros(width, np.float32) for name, width in norms.items()}
