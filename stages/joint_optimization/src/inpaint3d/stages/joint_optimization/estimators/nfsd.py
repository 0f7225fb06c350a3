"""Noise-free score distillation (arXiv:2310.17590); negative condition: known pixels smoothed."""

from typing import TYPE_CHECKING, Literal

from inpaint3d.stages.joint_optimization.estimators.base import Narrowing, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Nfsd(Narrowing, PriorEstimator):
    """Noise-free score distillation. It compares two conditions: the prior has to be shown the known pixels."""

    name: Literal["nfsd"] = "nfsd"

    def evaluations(self) -> int:
        return self.conditional_evaluations + 1

    def find_obstacle(self, prior: "Denoiser") -> str | None:
        from inpaint3d.diffusion.pipelines import PipelinePrior

        blind = isinstance(prior, PipelinePrior) and not prior.sees_mask
        return "compares two conditions, but this model is shown none" if blind else None

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import nfsd_gradient
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        g = self.guidance
        return PriorGuide(prior, lambda query: nfsd_gradient(prior, query, guidance=g))
