"""The render noised and denoised again is the target (arXiv:2212.00792, arXiv:2312.02981)."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from inpaint3d.stages.joint_optimization.estimators.base import Count, Narrowing, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class DenoisedTarget(Narrowing, PriorEstimator):
    """A target by a few DDIM steps from the noised render."""

    name: Literal["denoised-target"] = "denoised-target"
    denoise_steps: Count = Field(default=4, description="DDIM steps from the noised render to its target")

    def evaluations(self) -> int:
        return self.denoise_steps * self.conditional_evaluations

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import denoised_target_gradient
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        g, steps = self.guidance, self.denoise_steps
        return PriorGuide(prior, lambda query: denoised_target_gradient(prior, query, guidance=g, steps=steps))
