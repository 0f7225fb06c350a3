"""Noise-free score distillation (arXiv:2310.17590); negative condition: known pixels smoothed."""

from typing import TYPE_CHECKING, Literal

from inpaint3d.stages.joint_optimization.estimators.base import Narrowing, PriorEstimator, Setting

if TYPE_CHECKING:
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Nfsd(Narrowing, PriorEstimator):
    """Noise-free score distillation. It compares two conditions: the prior has to be shown the known pixels."""

    name: Literal["nfsd"] = "nfsd"

    def evaluations(self) -> int:
        return self.conditional_evaluations + 1

    def make_guide(self, to_fill: "tuple[MaskedView, ...]", setting: Setting) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import nfsd_gradient
        from inpaint3d.diffusion.pipelines import PipelinePrior
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        prior = self.load_prior(setting)
        if isinstance(prior, PipelinePrior) and not prior.sees_mask:
            raise self.refuse_pipeline(setting, "compares two conditions, but this model is shown none")
        return PriorGuide(
            prior,
            lambda q: nfsd_gradient(prior, q.x, q.mask, q.t, q.eps, guidance=self.guidance, noise_fill=q.noise_fill),
        )
