"""Parameters of a fit, whichever stage fits: the optimiser, and the weights of the loss terms.

Row numbers (N7, L3, ...) are those of docs/conformance.md. A stage whose defaults differ derives its own group and
gives them; what a parameter means stays here.
"""

from typing import Annotated

from pydantic import Field
from pydantic.config import JsonDict

from inpaint3d.contracts.models.base import Closed, Positive

Count = Annotated[int, Field(ge=1)]
# Bounds are where float32 still holds what is made of a parameter, far beyond what is of use.
Weight = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
Rate = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
Warmup = Annotated[int, Field(ge=0, description="steps of linear warm-up; 100 in the paper (N7)")]
AnnealSteps = Annotated[
    int, Field(ge=0, description="steps over which the proposals of a fresh field come into force; 0: at once")
]
WITH_PROPOSALS: JsonDict = {"x-under": {"architecture.sampler": "proposal"}}
WITH_SPARSE_POINTS: JsonDict = {"x-unless": {"loss_weights.line_of_sight": 0}}


class Optimizer(Closed):
    """How a field is moved."""

    learning_rate: Rate = Field(default=1e-2, description="at the start, after warm-up (N7)")
    final_learning_rate: Rate = Field(default=1e-3, description="at the end of its decay (N7)")
    learning_rate_steps: Count | None = Field(
        default=None, description="steps of the exponential decay; None: all steps; 2200 in the paper (N7)"
    )
    learning_rate_warmup: Warmup = 30
    network_rate_share: Positive = Field(default=1.0, le=1e3, description="networks' rate over the tables'")
    sparse_adam: bool = Field(
        default=False,
        description="True: table entries that no ray met rest, their moments and decay too; paper: False",
    )
    near_gradient: bool = Field(default=False, description="False: gradients near cameras are turned down; paper: True")
    proposal_anneal_steps: AnnealSteps = Field(default=0, json_schema_extra=WITH_PROPOSALS)
    rollbacks: Annotated[int, Field(ge=0)] = Field(
        default=1,
        description="how often a fit that meets numbers that are not finite goes back to its last checkpoint, "
        "its steps halved from there on, before it fails",
    )


class LossWeights(Closed):
    """Weights of the loss terms (L3); a term of weight 0 is not computed."""

    reconstruction: Positive = Field(default=1.0, le=1e6, description="colours of known pixels (L1)")
    interlevel: Weight = Field(
        default=1.0, description="proposals against the field (L5)", json_schema_extra=WITH_PROPOSALS
    )
    distortion: Weight = Field(default=0.005, description="compactness along rays (L4)")
    line_of_sight: Weight = Field(
        default=0.1, description="clear air before sparse points, and light that stops there; 0 in the paper"
    )
    hash_decay: Weight = Field(default=0.1, description="decay of the grids (N9)")
