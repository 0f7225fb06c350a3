"""Parameters of nerf-pretraining. Defaults: the `standard` preset, for two CPU cores.

Row numbers (N2, L3, ...) are those of docs/conformance.md, which also says what the paper's values are.
"""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Positive
from inpaint3d.radiance.architecture import Architecture
from inpaint3d.radiance.fitting import WITH_SPARSE_POINTS, LossWeights, Optimizer

Count = Annotated[int, Field(ge=1)]
Steps = Annotated[int, Field(ge=0)]


class Config(Closed):
    """How large the field is, and for how long it is fitted to what."""

    architecture: Architecture = Architecture()
    steps: Count = Field(default=800, description="optimisation steps; about 2200 in the paper (N7)")
    rays: Count = Field(default=512, description="random rays a step, over all views; 65536 in the paper (N8)")
    first_rays: Count = Field(
        default=256,
        description="rays of the first step; they grow to `rays` over `ramp_steps`",
        json_schema_extra={"x-unless": {"ramp_steps": 0}},
    )
    ramp_steps: Steps = Field(default=300, description="steps over which the rays of a step grow; paper: 0")

    optimizer: Optimizer = Optimizer()
    loss_weights: LossWeights = LossWeights()
    line_of_sight_rays: Count = Field(
        default=32,
        description="rays a step to sparse points, as the training views saw them",
        json_schema_extra=WITH_SPARSE_POINTS,
    )

    score_every: Count = Field(default=200, description="steps between points of the learning curve")
    score_views: Count = Field(default=4, description="held-out views that a point is taken over, at most")
    score_side: Count = Field(default=96, description="longest side of the pictures that a point is taken over, pixels")
    view_side: Count = Field(
        default=128, description="longest side of the stored renders of each view, pixels: masks are made of them"
    )
    block: Count = Field(default=4096, description="rays rendered at once where there is no other limit (memory)")
    checkpoint_every_s: Positive = Field(default=20.0, description="seconds between checkpoints; no effect on results")
