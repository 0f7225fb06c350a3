"""Iterative dataset update (arXiv:2303.12789): a picture of every view, made again from its render now and then."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Share
from inpaint3d.stages.joint_optimization.estimators.base import Count, PriorEstimator

if TYPE_CHECKING:
    from inpaint3d.diffusion.denoiser import Denoiser
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class DatasetUpdate(PriorEstimator):
    """One window of each view, over most of its hole, and a picture of it that is updated on the way."""

    name: Literal["dataset-update"] = "dataset-update"
    denoise_steps: Count = Field(default=4, description="DDIM steps from the noised render to a view's picture")
    update_every: Count = Field(default=10, description="windows of a view from one update to the next")
    span: Share = Field(default=0.75, description="side of the windows, share of the short side (S1)")

    def span_at(self, since: int, total: int) -> float:  # noqa: ARG002 - windows stay as they are
        return self.span

    def evaluations(self) -> int:
        return self.denoise_steps * self.conditional_evaluations

    def cost(self) -> str:
        return f"{self.evaluations()} UNet evaluations at every {self.update_every}th distilled step of a view"

    def guide_by(self, prior: "Denoiser", to_fill: "tuple[MaskedView, ...]", seed: int) -> "Guide":  # noqa: ARG002
        from inpaint3d.scene.windows import choose_fixed_windows
        from inpaint3d.stages.joint_optimization.guidance import DatasetGuide

        windows = choose_fixed_windows(to_fill, size=prior.size, span=self.span, min_known=self.min_known)
        return DatasetGuide(
            prior, windows, guidance=self.guidance, steps=self.denoise_steps, update_every=self.update_every
        )
