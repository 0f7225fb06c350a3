"""Parameters of nerf-pretraining. Defaults: the `standard` preset, for two CPU cores.

Row numbers (N2, L3, ...) are those of docs/conformance.md, which also says what the paper's values are.
"""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.model import Closed, Positive, Share

Count = Annotated[int, Field(ge=1)]
Samples = Annotated[int, Field(ge=2)]
Steps = Annotated[int, Field(ge=0)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Log2 = Annotated[int, Field(ge=4, le=28)]


class Architecture(Closed):
    """Size of the field. What the effect plan switches off is left out."""

    levels: Count = Field(default=8, description="resolutions of the hash grid; 10 in the paper (N3)")
    coarsest: Count = Field(default=16, description="cells per side at the coarsest level (N3)")
    finest: Count = Field(default=1024, description="cells per side at the finest level; 8192 in the paper (N3)")
    log2_table: Log2 = Field(default=17, description="log2 of the entries of a level; 21 in the paper (N3)")
    channels: Count = Field(default=2, description="numbers per entry; 4 in the paper (N3)")
    samples: Samples = Field(default=16, description="field samples a ray; 32 in the paper (N2)")
    proposal_samples: tuple[Samples, ...] = Field(
        default=(32, 24), description="samples a ray of each proposal round; 64, 64 in the paper (N2)"
    )
    proposal_levels: Count = Field(default=5, description="resolutions of the proposal's grid; 10 in the paper (N3)")
    proposal_finest: Count = Field(default=256, description="cells per side of its finest level; 8192 in the paper")
    proposal_log2_table: Log2 = Field(default=15, description="log2 of the entries of its levels; 21 in the paper")
    density_width: Count = Field(default=64, description="width of the density networks (N4)")
    bottleneck: Count = Field(default=15, description="numbers that reach the view-dependent network (N4)")
    view_width: Count = Field(default=64, description="width of the view-dependent network (N4)")
    view_layers: Count = Field(default=2, description="its hidden layers, where the plan has view dependence on (N4)")
    glo: Count = Field(default=4, description="length of the appearance codes, where the plan has exposure on (N6)")
    near_share: Share = Field(default=0.1, description="where rays start, as a share of the capture's centre depth")
    far: Positive = Field(default=1000.0, description="where rays end in an unbounded scene, scene units")


class Config(Closed):
    """How large the field is, and for how long it is fitted to what."""

    architecture: Architecture = Architecture()
    steps: Count = Field(default=1200, description="optimisation steps; about 2200 in the paper (N7)")
    rays: Count = Field(default=1024, description="random rays a step, over all views; 65536 in the paper (N8)")
    first_rays: Count = Field(default=256, description="rays of the first step; they grow to `rays` over `ramp_steps`")
    ramp_steps: Steps = Field(default=300, description="steps over which the rays of a step grow; paper: 0")

    learning_rate: Positive = Field(default=1e-2, description="at the start, after warm-up (N7)")
    final_learning_rate: Positive = Field(default=5e-4, description="at the end of its decay; 1e-3 in the paper (N7)")
    learning_rate_steps: Count | None = Field(
        default=None, description="steps of the exponential decay; None: all steps; 2200 in the paper (N7)"
    )
    learning_rate_warmup: Steps = Field(default=30, description="steps of linear warm-up; 100 in the paper (N7)")
    network_rate_share: Positive = Field(default=0.2, description="networks' rate over the tables'; 1 in the paper")
    near_gradient: bool = Field(default=False, description="False: gradients near cameras are turned down; paper: True")
    proposal_anneal_steps: Steps = Field(
        default=0, description="steps over which proposals come into force; 0: at once"
    )

    interlevel_weight: Weight = Field(default=1.0, description="L3, L5")
    distortion_weight: Weight = Field(default=0.005, description="L3, L4")
    hash_decay_weight: Weight = Field(default=0.1, description="weight decay of the grids (N9)")

    score_every: Count = Field(default=200, description="steps between points of the learning curve")
    score_views: Count = Field(default=4, description="held-out views that a point is taken over, at most")
    score_side: Count = Field(default=96, description="longest side of the pictures that a point is taken over, pixels")
    view_side: Count = Field(default=160, description="longest side of the stored renders of each view, pixels")
    block: Count = Field(default=4096, description="rays rendered at once where there is no other limit (memory)")
    checkpoint_every_s: Positive = Field(default=20.0, description="seconds between checkpoints; no effect on results")
