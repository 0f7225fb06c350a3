"""A 2D inpainting diffusion prior: architecture, how it was trained, weights."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from inpaint3d.contracts.models.base import Closed, Finite, Positive, RelativePath, Share

Count = Annotated[int, Field(ge=1)]


class PriorSpec(Closed):
    """Architecture and query convention of a prior (conformance D5 to D11). It is queried exactly as it was trained."""

    size: Count = Field(default=256, description="side of the square it was trained on, pixels")
    width: Count = Field(default=128, description="channels at full resolution")
    multipliers: tuple[Count, ...] = (1, 2, 4, 8)
    blocks: tuple[Count, ...] = (2, 4, 8, 8)
    attention: tuple[bool, ...] = (False, False, False, True)
    packing: Count = Field(default=1, description="space-to-depth factor before the first convolution")
    condition: Literal["noise-fill", "mask-channel"] = Field(
        default="noise-fill",
        description="how the hole is shown: filled with noise (D5), or a mask channel and a classical fill",
    )
    known: Literal["noised", "clean"] = Field(default="noised", description="what z_t holds in the known region (D9)")
    loss_region: Literal["all", "hole"] = "all"
    fill: Literal["pyramid"] = Field(
        default="pyramid",
        description="mask-channel only: what the hole holds in the condition; 'pyramid': push-pull",
    )
    prediction: Literal["eps", "v", "x0", "residual"] = Field(
        default="eps",
        description="what the network's output means; 'residual': EDM preconditioning about the fill",
    )
    residual_bands: tuple[Positive, ...] = Field(
        default=(0.2, 0.46, 1.05, 2.3, 4.6, 9.2),
        description="residual only: spread of lightness about the fill by band of an orthonormal Haar "
        "transform, finest first, the last for all that is coarser; pixel values in [-1, 1]",
    )
    residual_colours: tuple[Positive, Positive, Positive] = Field(
        default=(1.0, 0.25, 0.14),
        description="residual only: spread of each opponent colour (lightness, red-blue, green-magenta) as a share of "
        "lightness's",
    )
    schedule: Literal["cosine", "linear", "shifted"] = Field(
        default="cosine",
        description="how often training visits each noise level: uniform in the t of this schedule; 'shifted': cosine "
        "moved by 2 log(64 / size) in log SNR",
    )
    condition_dropout: Share = 0.1

    @model_validator(mode="after")
    def _check_residual_has_a_fill(self) -> "PriorSpec":
        if self.prediction == "residual" and self.condition != "mask-channel":
            raise ValueError("prediction 'residual' is about the fill, which only condition 'mask-channel' has")
        return self


class DiffusionPrior(Closed):
    """EMA weights (`weights.safetensors`), spec, `training_curve.csv` (step, loss, held_out_loss), sample grids."""

    spec: PriorSpec
    weights: RelativePath = "weights.safetensors"
    onnx: RelativePath | None = Field(
        default=None, description="the network for onnxruntime: batches of pictures of the spec's size"
    )
    runtime: Literal["torch", "onnxruntime"] = Field(default="torch", description="what it is to be queried with")
    query_seconds: dict[str, Positive] = Field(
        default={}, description="wall seconds of a denoising step by runtime, where the faster one was asked for"
    )
    training_curve: RelativePath = "training_curve.csv"
    samples: tuple[RelativePath, ...] = Field(default=(), description="grids: masked, sample, truth")
    steps: int
    seed: int
    trained_on: str = Field(description="what pictures, how many, which pixels")
    start: str = Field(default="scratch", description="'scratch' or the digest of the prior it was fine-tuned from")
    held_out: dict[str, Finite] = Field(default={}, description="figures on held-out crops, by name")
    non_finite: dict[str, int] = {}

    @model_validator(mode="after")
    def _check_runtime_is_there(self) -> "DiffusionPrior":
        if self.runtime == "onnxruntime" and self.onnx is None:
            raise ValueError("runtime 'onnxruntime' needs the network as ONNX: name its file in 'onnx'")
        return self
