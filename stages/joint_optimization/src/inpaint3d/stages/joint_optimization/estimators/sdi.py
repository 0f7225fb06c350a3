"""Score distillation via DDIM inversion (arXiv:2405.15891); inverted without guidance."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from inpaint3d.stages.joint_optimization.estimators.base import Count, Narrowing, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Sdi(Narrowing, PriorEstimator):
    """Score distillation via inversion."""

    name: Literal["sdi"] = "sdi"
    inversion_steps: Count = Field(default=4, description="DDIM steps from the render to its noise")

    def evaluations(self) -> int:
        return self.inversion_steps + self.conditional_evaluations

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.diffusion.distillation import sdi_gradient
        from inpaint3d.stages.joint_optimization.guidance import PriorGuide

        g, steps = self.guidance, self.inversion_steps
        return PriorGuide(prior, lambda query: sdi_gradient(prior, query, guidance=g, steps=steps))
