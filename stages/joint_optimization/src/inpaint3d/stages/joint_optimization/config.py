"""Parameters of the joint optimisation. Defaults: the `standard` preset, for two CPU cores.

Row numbers (S6, L3, ...) are those of docs/conformance.md, which also says what the paper's values are.
"""

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.config import JsonDict

from inpaint3d.contracts.models.base import Closed, Positive
from inpaint3d.radiance.architecture import Architecture
from inpaint3d.radiance.fitting import (
    WITH_PROPOSALS,
    WITH_SPARSE_POINTS,
    AnnealSteps,
    LossWeights,
    Optimizer,
    Warmup,
    Weight,
)
from inpaint3d.stages.joint_optimization.estimators import READS, AnyEstimator
from inpaint3d.stages.joint_optimization.estimators.completed_views import CompletedViewsEstimator

Count = Annotated[int, Field(ge=1)]
WITH_DEPTH: JsonDict = {"x-unless": {"loss_weights.depth": 0}}


class JointOptimizer(Optimizer):
    """How the field is moved; a field that comes with an initial field more carefully."""

    learning_rate_warmup: Warmup = 20
    proposal_anneal_steps: AnnealSteps = Field(
        default=100, json_schema_extra={"x-without": "initial-field", **WITH_PROPOSALS}
    )
    warm_start_lr_scale: Positive = Field(
        default=0.3,
        le=1e3,
        description="share of the learning rates that an initial field gets: at the full rate it forgets what it knows",
        json_schema_extra={"x-with": "initial-field"},
    )


class JointLossWeights(LossWeights):
    """Weights of the terms beside the estimator's own."""

    depth: Weight = Field(default=1e-4, description="depth smoothness (L6)")


class Config(Closed):
    """What is optimised, against what, and for how long."""

    estimator: AnyEstimator = Field(
        default=CompletedViewsEstimator(), description="what fills the hole", json_schema_extra={"x-reads": READS}
    )
    start: Literal["initial-field", "fresh"] = Field(
        default="initial-field",
        description="where the field starts: from the initial field, where one is wired, or from nothing (the paper)",
        json_schema_extra={"x-reads": {"initial-field": ["initial-field"], "fresh": []}, "x-with": "initial-field"},
    )
    ranks: Count = Field(
        default=1,
        description="processes that each take a patch and a share of the rays, and step along their mean gradient "
        "(S12); 16 in the paper",
    )
    steps: Count = Field(default=1600, description="steps done (S11: 600 to 1600 in the paper)")
    rays: Count = Field(default=512, description="random rays a step, over all views; 65536 in the paper (N8)")
    architecture: Architecture = Field(default=Architecture(), json_schema_extra={"x-without": "initial-field"})
    optimizer: JointOptimizer = JointOptimizer()
    loss_weights: JointLossWeights = JointLossWeights()
    line_of_sight_rays: Count = Field(
        default=32,
        description="rays a step to sparse points that no mask covers",
        json_schema_extra=WITH_SPARSE_POINTS,
    )
    depth_patches: Count = Field(
        default=4, description="patches a step for depth smoothness (L6)", json_schema_extra=WITH_DEPTH
    )
    depth_patch_size: Annotated[int, Field(ge=2)] = Field(
        default=8, description="their side, pixels; paper: 64 (L6)", json_schema_extra=WITH_DEPTH
    )
    block: Count = Field(default=8192, description="rays rendered at once where there is no other limit (memory)")
    score_every: Count = Field(default=50, description="steps between points of the learning curve")
    score_pixels: Count = Field(default=1024, description="known pixels of each test view that a point is taken over")
    terms_every: Count = Field(default=50, description="steps between rows of gradient norms")
    view_side: Count = Field(default=160, description="longest side of the stored renders of each view, pixels")

    @model_validator(mode="after")
    def _check_ranks(self) -> "Config":
        if self.rays % self.ranks:
            raise ValueError(f"rays {self.rays} do not share out over {self.ranks} ranks; make them a multiple")
        if getattr(self.estimator, "name", "") == "dataset-update" and self.ranks > 1:
            raise ValueError("dataset-update keeps one set of pictures; set ranks: 1, or choose another estimator")
        return self
