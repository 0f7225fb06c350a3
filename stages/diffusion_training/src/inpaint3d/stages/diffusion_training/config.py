"""Parameters of diffusion training. Defaults: the `standard` preset, under three minutes on one CPU core."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from inpaint3d.contracts.models.artifacts.prior import PriorSpec
from inpaint3d.contracts.models.base import Closed, Positive, Share

Count = Annotated[int, Field(ge=1)]


class MaskMix(Closed):
    """Shares of the kinds of random holes; they sum to 1."""

    rectangles: Share = Field(default=0.2, description="one to three boxes (the paper's inpainting masks, D4)")
    strokes: Share = Field(default=0.2, description="free-form strokes over much of the picture (D4)")
    blobs: Share = Field(default=0.3, description="wavy ellipses: what spheres and objects project to")
    own: Share = Field(default=0.3, description="shapes of the capture's own masks, at other places and sizes")

    @model_validator(mode="after")
    def _sum_to_one(self) -> "MaskMix":
        total = self.rectangles + self.strokes + self.blobs + self.own
        if abs(total - 1) > 1e-6:
            raise ValueError(f"shares of the mask mix sum to {total}; they must sum to 1")
        return self


SMALL = PriorSpec(
    size=64,
    width=48,
    multipliers=(1, 2, 4),
    blocks=(2, 2, 2),
    attention=(False, False, True),
    packing=2,
    condition="mask-channel",
    known="clean",
    loss_region="hole",
    prediction="residual",
)
"""6.4 M parameters; 64 pixels, which the network sees as 32 of four times the channels."""


OF_LEARNING = (
    "batch", "parts", "learning_rate", "fine_tuning_rate", "warm_up", "ema", "t_range", "corpus_share", "curve_rows",
    "compiled",
)  # fmt: skip
"""Parameters that count where something is learnt."""


class Config(Closed):
    """How the prior is built and for how long it learns."""

    start: Literal["pretrained-prior", "fresh"] = Field(
        default="pretrained-prior",
        description="where the weights start: from the pretrained prior, if one is wired, or from nothing (the paper)",
        json_schema_extra={"x-reads": {"pretrained-prior": ["pretrained-prior"], "fresh": []}},
    )
    prior: PriorSpec = Field(
        default=SMALL,
        description="architecture and conditioning; a pretrained prior brings its own",
        json_schema_extra={"x-without": "pretrained-prior"},
    )
    steps: Annotated[int, Field(ge=0)] = Field(default=260, description="training steps; 2,250,000 in the paper (D12)")
    batch: Count = Field(default=8, description="crops of a part of a step (D12); memory is that of one part")
    parts: Count = Field(
        default=1, description="parts of a step, whose gradients are accumulated, or shared out over ranks"
    )
    learning_rate: Positive = Field(
        default=8e-4,
        le=10,
        description="peak of Adam's rate from scratch; 1e-4 in the paper (D13)",
        json_schema_extra={"x-without": "pretrained-prior"},
    )
    fine_tuning_rate: Positive = Field(
        default=3e-4,
        le=10,
        description="peak of Adam's rate from a pretrained prior",
        json_schema_extra={"x-with": "pretrained-prior"},
    )
    warm_up: Annotated[int, Field(ge=0)] = Field(default=20, description="steps of linear warm-up of the rate")
    ema: Share = Field(default=0.99, description="decay of the running average of weights; 0.9999 in the paper (D13)")
    t_range: tuple[Share, Share] = Field(
        default=(0.02, 1.0), description="noise levels learnt; (0, 1) in the paper (D10)"
    )
    crop_share: tuple[Share, Share] = Field(
        default=(0.45, 1.0),
        description="side of the square crops, share of the frame's shorter side (D3)",
        json_schema_extra={"x-unless": {"whole_share": 1}},
    )
    whole_share: Share = Field(
        default=0.0, description="share of crops that are the largest square of their frame instead (D3)"
    )
    enlarged: Annotated[float, Field(ge=1, le=100)] = Field(
        default=1.0, description="by how much a crop may be enlarged; 1.5 in the paper, from 720 rows to 1080 (D2)"
    )
    masks: MaskMix = MaskMix()
    corpus_share: Share = Field(
        default=0.5,
        description="share of crops from the image corpus, where one is wired",
        json_schema_extra={"x-with": "image-corpus"},
    )
    exam: Count = Field(default=24, description="held-out crops that the prior is judged on")
    sample_steps: Count = Field(
        default=3,
        description="DDIM steps of the samples that it is judged by; more add grain that a small prior has not learnt",
    )
    curve_rows: Count = Field(default=10, description="rows of the training curve")
    precision: Literal["auto", "fp32", "bf16"] = Field(
        default="auto", description="of the matrix products; auto: bf16 where the processor has units for it"
    )
    channels_last: bool = Field(default=False, description="keep channels innermost in memory")
    compiled: bool = Field(default=False, description="compile the network before training; costs minutes at the start")
    runtime: Literal["torch", "onnxruntime", "fastest"] = Field(
        default="torch",
        description="what the prior is queried with afterwards; fastest: measured on this machine, so that two runs "
        "may differ",
    )

    @model_validator(mode="after")
    def _something_is_learnt(self) -> "Config":
        if self.steps:
            return self
        if self.start == "fresh":
            raise ValueError("steps is 0 and start is fresh: nothing would be learnt; give steps, some hundreds")
        idle = [name for name in OF_LEARNING if getattr(self, name) != type(self).model_fields[name].default]
        if idle:
            raise ValueError(f"{', '.join(idle)} would change nothing: steps is 0; give steps too")
        return self

    @model_validator(mode="after")
    def _ranges_rise(self) -> "Config":
        for name in ("t_range", "crop_share"):
            low, high = getattr(self, name)
            if low > high or high == 0:
                raise ValueError(f"{name} is ({low}, {high}): give (low, high) with low <= high and high > 0")
        return self
