"""Interval score matching (arXiv:2311.11284)."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from inpaint3d.stages.joint_optimization.estimators.base import Count, Narrowing, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Ism(Narrowing, PriorEstimator):
    """Interval score matching."""

    name: Literal["ism"] = "ism"
    inversion_steps: Count = Field(default=4, description="DDIM steps from the render to the noise level before t")

    def evaluations(self) -> int:
        return self.inversion_steps + 1 + self.conditional_evaluations

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import ism_gradient
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        g, steps = self.guidance, self.inversion_steps
        return PriorGuide(prior, lambda query: ism_gradient(prior, query, guidance=g, steps=steps))
