"""Score distillation (DreamFusion, arXiv:2209.14988): the paper's estimator."""

from typing import TYPE_CHECKING, Literal

from inpaint3d.stages.joint_optimization.estimators.base import Narrowing, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Sds(Narrowing, PriorEstimator):
    """Score distillation sampling."""

    name: Literal["sds"] = "sds"

    def evaluations(self) -> int:
        return self.conditional_evaluations

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import sds_gradient
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        g = self.guidance
        return PriorGuide(prior, lambda query: sds_gradient(prior, query, guidance=g))
