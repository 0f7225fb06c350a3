"""What every estimator is: parameters that it alone takes, and the guide that it makes of what is wired.

No tensor library is imported here: parameters are checked before anything starts.
"""

from abc import abstractmethod
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator
from pydantic.config import JsonDict

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.base import Closed, Finite, Positive, Share
from inpaint3d.stages.joint_optimization.schedule import (
    TimestepRange,
    specular_scale,
    timestep_range,
    window_span,
)

if TYPE_CHECKING:
    from inpaint3d.contracts.kit.context import Inputs
    from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
    from inpaint3d.contracts.store import Artifact
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.radiance.fields import RadianceField
    from inpaint3d.scene.masked_views import MaskedScene, MaskedView
    from inpaint3d.stages.joint_optimization.batch import Filled
    from inpaint3d.stages.joint_optimization.guidance import Guide

Count = Annotated[int, Field(ge=1)]
Steps = Annotated[int, Field(ge=0)]
PRIOR = "diffusers-pipeline|diffusion-prior"
PULLING: JsonDict = {"x-unless": {"weight": 0}}
"""Of what counts where a guide pulls; at a weight of 0 completed views are fitted ray by ray alone."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What an estimator may look at: the masked scene, the field at its start (on the CPU), what is wired."""

    scene: "MaskedScene"
    field: "RadianceField"
    initial: "Artifact[RadianceFieldArtifact] | None"
    inputs: "Inputs"
    seed: int
    device: str


@dataclass(frozen=True, eq=False)
class Preparation:
    """to_fill: the training views with the holes that the guide is to fill. filled: pictures to fit in the hole.

    reasons: what was decided, in words, for the artifact.
    """

    to_fill: "tuple[MaskedView, ...]"
    guide: "Guide | None" = None
    filled: "Filled | None" = None
    reasons: dict[str, str] = field(default_factory=dict[str, str])


class Estimator(Closed):
    """A way to fill the hole."""

    reads: ClassVar[tuple[str, ...]] = ()

    @property
    def diffuse_first(self) -> bool:
        """Whether the prior is to see diffuse colour first (S10)."""
        return False

    def label(self, *, continued: bool, completion: str | None) -> str:  # noqa: ARG002 - some names depend on neither
        """What its field is called in reports. continued: it started from an initial field; completion: the method of
        the completed views that are wired.
        """
        return f"joint-{getattr(self, 'name')}"  # noqa: B009 - every estimator has one, of a type of its own

    @abstractmethod
    def prepare(self, setting: Setting) -> Preparation:
        """What is filled, by what. Raises ConfigurationError or BadInputError where what is wired does not do."""


class Guided(Estimator):
    """An estimator whose guide pulls rendered windows of the hole."""

    needs_surround: ClassVar[bool] = False
    """Whether a window without any known pixel says nothing to the guide."""

    distill_every: Count = Field(default=2, description="steps from one window to the next; 1 in the paper")
    weight: Positive = Field(default=0.1, le=1e6, description="peak weight of the distillation term (S6)")
    weight_warmup: Steps = Field(
        default=100,
        description="distillation steps over which the weight rises from 0 (S6)",
        json_schema_extra=PULLING,
    )
    weight_decay_to: Share = Field(
        default=1.0, description="cosine decay to this share of the peak (S13)", json_schema_extra=PULLING
    )
    warmup_steps: Steps = Field(
        default=200,
        description="reconstruction-only steps at a fresh start; none with an initial field (S7)",
        json_schema_extra={"x-without": "initial-field", **PULLING},
    )
    centre_steps: Steps = Field(
        default=50, description="distillation steps on the centre views only (S8)", json_schema_extra=PULLING
    )
    centre_views: Count = Field(
        default=3,
        description="how many views the centre phase uses (S8)",
        json_schema_extra={"x-unless": {"weight": 0, "centre_steps": 0}},
    )
    min_known: Share = Field(
        default=0.2,
        description="share of a window that is known, where a view has such (S1)",
        json_schema_extra=PULLING,
    )

    def timesteps_at(self, step: int, steps: int) -> TimestepRange | None:  # noqa: ARG002 - of those that noise
        """Where the diffusion time is drawn from at a step of `steps`; None where nothing is noised."""
        return None

    def specular_at(self, step: int, steps: int) -> float:  # noqa: ARG002
        """Share of the view-dependent colour in what the guide sees (S10)."""
        return 1.0

    @abstractmethod
    def span_at(self, since: int, total: int) -> float:
        """Side of a window as a share of the picture's short side, `since` steps into `total` of distillation."""


class Narrowing(Closed):
    """Windows that narrow over the run."""

    span_first: Share = Field(default=0.75, description="side of the first windows, share of the short side (S1)")
    span_last: Share = Field(default=0.5, description="side of the last windows, share of the short side (S1)")

    def span_at(self, since: int, total: int) -> float:
        return window_span(since, total, first=self.span_first, last=self.span_last)


class HoleFilling(Guided):
    """An estimator that fills the hole itself, where other views do not show what is behind it."""

    needs_surround: ClassVar[bool] = True

    hole: Literal["as-masked", "unseen"] = Field(
        default="unseen",
        description="what is filled: all that is masked (the paper), or what other views do not show "
        "(needs an initial field)",
    )
    min_supporting_views: Count = Field(
        default=2,
        description="unseen: other views that must know a masked surface for it to be left alone",
        json_schema_extra={"x-with": "initial-field", "x-under": {"hole": "unseen"}},
    )

    def prepare(self, setting: Setting) -> Preparation:
        from inpaint3d.scene.masked_views import find_fillable

        to_fill, reasons = self._reduce(setting)
        if not find_fillable(to_fill):
            raise BadInputError(
                "no training view shows both the hole and something known around it, so that nothing can be told of "
                "it; author another mask, or set estimator: none"
            )
        return Preparation(to_fill, self.make_guide(to_fill, setting), reasons=reasons | {"cost": self.cost()})

    def _reduce(self, setting: Setting) -> "tuple[tuple[MaskedView, ...], dict[str, str]]":
        """The views with holes reduced to what other views do not show, and what that left, in words."""
        from inpaint3d.scene.masked_views import find_fillable
        from inpaint3d.scene.visibility import load_depth_maps, shrink_holes

        views = setting.scene.train
        if setting.initial is None or self.hole == "as-masked":
            return views, {}
        depths = load_depth_maps(views, setting.initial)
        reduced = tuple(shrink_holes(views, depths, self.min_supporting_views))
        if not find_fillable(reduced):
            return views, {"hole": "as masked: other views show all that is behind it"}
        before, after = (sum(int(v.hole.sum()) for v in some) for some in (views, reduced))
        words = f"{after / before:.0%} of what is masked, which {self.min_supporting_views} other views do not show"
        return reduced, {"hole": words}

    @abstractmethod
    def make_guide(self, to_fill: "tuple[MaskedView, ...]", setting: Setting) -> "Guide":
        """The guide that pulls the holes of these views."""

    @abstractmethod
    def cost(self) -> str:
        """What a distilled step costs beside its render, in words."""


class PriorEstimator(HoleFilling):
    """An estimator that asks a diffusion prior."""

    reads: ClassVar[tuple[str, ...]] = (PRIOR,)

    guidance: Finite = Field(
        default=1.0, ge=-1e6, le=1e6, description="g in eps_null + g (eps_cond - eps_null); paper: 8, 2, 5 (S5)"
    )
    prompt: str = Field(
        default="",
        description="what a diffusers pipeline that takes text is told of the picture",
        json_schema_extra={"x-with": "diffusers-pipeline"},
    )
    t_max: Share = Field(default=0.95, description="largest diffusion time (S9)")
    t_min: Share = Field(
        default=0.95,
        description="where the upper end of the diffusion times stops (S9); 0.2 in the paper. A small prior is biased "
        "at low times, where nothing pulls the hole back to what surrounds it",
    )
    t_width: Share = Field(default=0.1, description="width of the interval of diffusion times (S9); 0.2 in the paper")
    t_floor: Positive = Field(default=0.02, le=1, description="no diffusion time lies below this (S9)")
    diffuse_start: bool = Field(
        default=False,
        description="the prior sees diffuse colour first (S10); True in the paper; no effect without specular colour",
    )
    schedule_steps: Count | None = Field(
        default=None,
        description="S of the schedules in t and specular colour; None: as many as done; 2200 in the paper",
    )

    @model_validator(mode="after")
    def _check_schedule(self) -> Self:
        if self.t_max < self.t_min:
            raise ValueError(
                f"t_max {self.t_max} lies below t_min {self.t_min}, where times stop falling; lower t_min too"
            )
        if self.schedule_steps is not None and self.t_max == self.t_min and not self.diffuse_start:
            raise ValueError(
                f"schedule_steps changes nothing: t_min and t_max are both {self.t_max}, so that times do not fall, "
                "and diffuse_start is off; lower t_min"
            )
        return self

    @property
    def diffuse_first(self) -> bool:
        return self.diffuse_start

    def timesteps_at(self, step: int, steps: int) -> TimestepRange | None:
        return timestep_range(
            step,
            self.schedule_steps or steps,
            t_min=self.t_min,
            t_max=self.t_max,
            width=self.t_width,
            floor=self.t_floor,
        )

    def specular_at(self, step: int, steps: int) -> float:
        return specular_scale(step, self.schedule_steps or steps) if self.diffuse_start else 1.0

    @property
    def conditional_evaluations(self) -> int:
        """UNet evaluations for one guided answer."""
        return 1 if self.guidance in (0.0, 1.0) else 2

    @abstractmethod
    def evaluations(self) -> int:
        """UNet evaluations of a distilled step; a backward pass, where there is one, counts as two."""

    def cost(self) -> str:
        return f"{self.evaluations()} UNet evaluations a distilled step"

    trains_copy: ClassVar[bool] = False
    """Whether a copy of the prior learns on the way."""

    def make_guide(self, to_fill: "tuple[MaskedView, ...]", setting: Setting) -> "Guide":
        """The guide that asks what is wired; errors as of `load_denoiser`, ConfigurationError for a pipeline that this
        estimator cannot use.
        """
        from inpaint3d.contracts.models.artifacts import DiffusersPipeline
        from inpaint3d.diffusion.loading import load_denoiser

        asker = f"estimator {getattr(self, 'name')!r}"  # noqa: B009
        prior = load_denoiser(
            setting.inputs, asker=asker, prompt=self.prompt, device=setting.device, trainable=self.trains_copy
        )
        if (obstacle := self.find_obstacle(prior)) is not None:
            kind = setting.inputs.one("diffusers-pipeline", DiffusersPipeline).metadata.kind
            raise ConfigurationError(
                f"{asker} {obstacle}; the prior is the {kind} at the input diffusers-pipeline: set another estimator "
                "(sds, sdi, ism, denoised-target, dataset-update), or give no pipeline"
            )
        return self.guide_by(prior, to_fill, setting.seed)

    def find_obstacle(self, prior: "Denoiser") -> str | None:  # noqa: ARG002 - most take any
        """Why this estimator cannot use a diffusers pipeline; None where it can."""
        return None

    @abstractmethod
    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":
        """The guide that asks a prior."""
