"""Variational score distillation (arXiv:2305.16213) with a low-rank copy that is not told the camera."""

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from inpaint3d.radiance.fitting import Rate
from inpaint3d.stages.joint_optimization.estimators.base import Count, Narrowing, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Vsd(Narrowing, PriorEstimator):
    """Variational score distillation: a copy of the prior learns the renders on the way."""

    trains_copy: ClassVar[bool] = True

    name: Literal["vsd"] = "vsd"
    copy_rank: Count = Field(default=4, description="rank of what the prior's copy may learn")
    copy_learning_rate: Rate = Field(default=1e-3, description="learning rate of the copy")

    def evaluations(self) -> int:
        learning = 3  # the copy's forward pass, and backward for two
        return self.conditional_evaluations + 1 + learning

    def find_obstacle(self, prior: "Denoiser") -> str | None:
        from inpaint3d.diffusion.prior import InpaintingPrior

        own = isinstance(prior, InpaintingPrior)
        return None if own else "teaches the renders to a copy of its prior, which is done for the trained prior alone"

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import vsd_gradient
        from inpaint3d.diffusion.low_rank import LowRankCopy
        from inpaint3d.diffusion.prior import InpaintingPrior
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        if not isinstance(prior, InpaintingPrior):
            raise TypeError(f"a copy learns of the trained prior alone, not of {type(prior).__name__}")
        copy = LowRankCopy(prior, rank=self.copy_rank, rate=self.copy_learning_rate, seed=seed)
        g = self.guidance
        return PriorGuide(prior, lambda query: vsd_gradient(prior, copy.network, query, guidance=g), copy)
