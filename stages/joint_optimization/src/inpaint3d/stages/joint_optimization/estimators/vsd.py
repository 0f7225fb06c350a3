"""Variational score distillation (arXiv:2305.16213) with a low-rank copy that is not told the camera."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from inpaint3d.contracts.model import Positive
from inpaint3d.stages.joint_optimization.estimators.base import Count, Narrowing, PriorEstimator, Setting

if TYPE_CHECKING:
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Vsd(Narrowing, PriorEstimator):
    """Variational score distillation: a copy of the prior learns the renders on the way."""

    name: Literal["vsd"] = "vsd"
    copy_rank: Count = Field(default=4, description="rank of what the prior's copy may learn")
    copy_learning_rate: Positive = Field(default=1e-3, description="learning rate of the copy")

    def evaluations(self) -> int:
        learning = 3  # the copy's forward pass, and backward for two
        return self.conditional_evaluations + 1 + learning

    def make_guide(self, to_fill: "tuple[MaskedView, ...]", setting: Setting) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import vsd_gradient
        from inpaint3d.diffusion.low_rank import LowRankCopy
        from inpaint3d.diffusion.prior import InpaintingPrior
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        prior = self.load_prior(setting, trainable=True)
        if not isinstance(prior, InpaintingPrior):
            raise self.refuse_pipeline(
                setting, "teaches the renders to a copy of its prior, which is done for the trained prior alone"
            )
        copy = LowRankCopy(prior, rank=self.copy_rank, rate=self.copy_learning_rate, seed=setting.seed)
        return PriorGuide(
            prior,
            lambda q: vsd_gradient(
                prior, copy.network, q.x, q.mask, q.t, q.eps, guidance=self.guidance, noise_fill=q.noise_fill
            ),
            copy,
        )
