"""Parameters of the joint optimisation. Defaults: the `standard` preset, for two CPU cores.

Row numbers (S6, L3, ...) are those of docs/conformance.md, which also says what the paper's values are.
"""

from typing import Annotated, Any, Literal, get_args

from pydantic import Field, model_validator

from inpaint3d.contracts.model import Closed, Finite, Positive, Share
from inpaint3d.radiance.sizing import Architecture

Count = Annotated[int, Field(ge=1)]
Steps = Annotated[int, Field(ge=0)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


Estimator = Literal[
    "none", "classical", "inpaint-then-nerf", "features", "reference",
    "sds", "nfsd", "sdi", "ism", "vsd", "denoised-target", "dataset-update",
]  # fmt: skip
WITHOUT_GUIDE = ("none", "classical")
WITHOUT_PRIOR = (*WITHOUT_GUIDE, "features", "reference")
ASKED = ["diffusers-pipeline|diffusion-prior"]
READS: dict[str, Any] = {name: [] if name in WITHOUT_PRIOR else ASKED for name in get_args(Estimator)}


class Config(Closed):
    """What is optimised, against what, and for how long."""

    estimator: Estimator = Field(
        default="reference",
        description="what fills the hole: none (reconstruction only); baselines: classical (every view inpainted by "
        "OpenCV, then reconstructed), inpaint-then-nerf (every view sampled from the prior with one seed, LPIPS); "
        "features (VGG16 features of the rest of the scene, no prior); reference (what other photos show, the rest by "
        "example in a reference view, carried by depth; no prior); the prior by sds (the paper), nfsd, sdi, ism, "
        "vsd, denoised-target, dataset-update",
        json_schema_extra={"x-reads": READS},
    )
    ranks: Count = Field(
        default=1,
        description="processes that each take a patch and a share of the rays, and step along their mean gradient "
        "(S12); 16 in the paper",
    )
    steps: Count = Field(default=1600, description="steps done (S11: 600 to 1600 in the paper)")
    schedule_steps: Count | None = Field(
        default=None,
        description="S of the schedules in t and specular colour; None: as many as done; 2200 in the paper",
    )

    rays: Count = Field(default=512, description="random rays a step, over all views; 65536 in the paper (N8)")
    architecture: Architecture = Architecture()
    learning_rate: Positive = Field(default=1e-2, description="at the start (N7)")
    final_learning_rate: Positive = Field(default=1e-3, description="at the end of its decay (N7)")
    learning_rate_steps: Count | None = Field(
        default=None, description="steps of the exponential decay; None: all steps; 2200 in the paper (N7)"
    )
    learning_rate_warmup: Steps = Field(default=20, description="steps of linear warm-up; 100 in the paper (N7)")
    carried_rate: Positive = Field(
        default=0.3,
        description="share of the learning rates that a field which is carried over gets: at the full rate it forgets "
        "what it knows",
    )
    network_rate_share: Positive = Field(default=1.0, description="networks' rate over the tables'")
    sparse_adam: bool = Field(
        default=False,
        description="True: table entries that no ray met rest, their moments and decay too; paper: False",
    )
    near_gradient: bool = Field(default=False, description="False: gradients near cameras are turned down; paper: True")
    proposal_anneal_steps: Steps = Field(default=100, description="steps over which proposals come into force")

    start: Literal["initial-field", "fresh"] = Field(
        default="initial-field",
        description="where the field starts: from the initial field, where one is wired, or from nothing (the paper)",
        json_schema_extra={"x-reads": {"initial-field": ["initial-field"], "fresh": []}},
    )
    warmup_steps: Steps = Field(
        default=200, description="reconstruction-only steps at the start; 0 with an initial field (S7)"
    )
    hole: Literal["as-masked", "unseen"] = Field(
        default="unseen",
        description="what the prior fills: all that is masked (the paper), or what other views do not show "
        "(needs an initial field)",
    )
    witnesses: Count = Field(
        default=2, description="other views that must know a masked surface for it to be left alone"
    )
    distill_every: Count = Field(default=2, description="steps from one distilled patch to the next; 1 in the paper")
    weight: Positive = Field(default=0.1, description="peak weight of the distillation term (S6)")
    weight_warmup: Steps = Field(default=100, description="distillation steps over which the weight rises from 0 (S6)")
    weight_decay_to: Share = Field(default=1.0, description="cosine decay to this share of the peak (S13)")
    guidance: Finite = Field(default=1.0, description="g in eps_null + g (eps_cond - eps_null); paper: 8, 2, 5 (S5)")
    prompt: str = Field(default="", description="what a diffusers pipeline that takes text is told of the picture")
    denoise_steps: Count = Field(
        default=4, description="DDIM steps of denoised-target and dataset-update, inversion steps of sdi and ism"
    )
    sample_steps: Count = Field(
        default=32, description="ancestral steps of inpaint-then-nerf for each view; 1000 in the paper"
    )
    update_every: Count = Field(default=10, description="patches of a view from one dataset-update to the next")
    copy_rank: Count = Field(default=4, description="rank of what vsd's copy of the prior may learn")
    copy_rate: Positive = Field(default=1e-3, description="learning rate of vsd's copy")
    matching: Literal["nearest", "sliced"] = Field(
        default="nearest", description="features: each to its nearest, or both sets by sliced Wasserstein distance"
    )
    references: Count = Field(default=2, description="features: windows of other views that a patch is matched with")
    feature_size: Count = Field(default=64, description="features, reference: side of the patch, pixels")
    reference_views: Count = Field(
        default=4, description="reference: views in which what no photo shows is made up, at most"
    )
    variety: Weight = Field(
        default=0.0,
        description="reference: by which share less alike than the best a patch may be that is copied; more than 0 "
        "makes the fill depend on the seed",
    )
    filled_share: Share = Field(
        default=0.4, description="reference: share of the rays of a step that are drawn from what was filled"
    )
    t_max: Share = Field(default=0.95, description="largest diffusion time (S9)")
    t_min: Share = Field(
        default=0.95,
        description="where the upper end of the diffusion times stops (S9); 0.2 in the paper. A small prior is biased "
        "at low times, where nothing pulls the hole back to what surrounds it",
    )
    t_width: Share = Field(default=0.1, description="width of the interval of diffusion times (S9); 0.2 in the paper")
    t_floor: Positive = Field(default=0.02, description="no diffusion time lies below this (S9)")
    centre_steps: Steps = Field(default=50, description="distillation steps on the centre views only (S8)")
    centre_views: Count = Field(default=3, description="how many views the centre phase uses (S8)")
    diffuse_start: bool = Field(
        default=False,
        description="the prior sees diffuse colour first (S10); True in the paper; no effect without specular colour",
    )
    span_first: Share = Field(default=0.75, description="side of the first windows, share of the short side (S1)")
    span_last: Share = Field(default=0.5, description="side of the last windows, share of the short side (S1)")
    least_known: Share = Field(default=0.2, description="share of a window that is known, where a view has such (S1)")

    reconstruction_weight: Positive = Field(default=1.0, description="L3")
    interlevel_weight: Weight = Field(default=1.0, description="L3")
    distortion_weight: Weight = Field(default=0.005, description="L3")
    sight_weight: Weight = Field(
        default=0.1,
        description="weight of clear air before the sparse points that no mask covers, and of light stopping there; "
        "0 in the paper",
    )
    sight_rays: Count = Field(default=32, description="rays a step to such points")
    depth_weight: Weight = Field(default=1e-4, description="weight of depth smoothness (L3, L6)")
    depth_patches: Count = Field(default=4, description="patches a step for depth smoothness (L6)")
    depth_patch_size: Annotated[int, Field(ge=2)] = Field(default=8, description="their side, pixels; paper: 64 (L6)")
    hash_decay_weight: Weight = Field(default=0.1, description="weight decay of the grids (N9)")

    block: Count = Field(default=8192, description="rays rendered at once where there is no other limit (memory)")
    score_every: Count = Field(default=50, description="steps between points of the learning curve")
    score_pixels: Count = Field(default=1024, description="known pixels of each test view that a point is taken over")
    terms_every: Count = Field(default=50, description="steps between rows of gradient norms")
    view_side: Count = Field(default=160, description="longest side of the stored renders of each view, pixels")

    @model_validator(mode="after")
    def _ranks_can_share(self) -> "Config":
        if self.rays % self.ranks:
            raise ValueError(f"rays {self.rays} do not share out over {self.ranks} ranks; make them a multiple")
        if self.estimator == "dataset-update" and self.ranks > 1:
            raise ValueError("dataset-update keeps one set of pictures; set ranks: 1, or choose another estimator")
        return self


def label_of(estimator: str, *, continued: bool) -> str:
    """What a field is called in reports. continued: it started from an initial field."""
    if estimator == "none":
        return "continued-reconstruction" if continued else "masked-reconstruction"
    if estimator in ("classical", "inpaint-then-nerf"):
        return f"{estimator.removesuffix('-then-nerf')}-then-nerf"
    return f"joint-{estimator}"
