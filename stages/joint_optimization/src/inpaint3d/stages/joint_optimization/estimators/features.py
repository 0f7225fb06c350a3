"""No prior: the hole should show what other views show elsewhere, by VGG16's features (`perception.matching`)."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from inpaint3d.stages.joint_optimization.estimators.base import Count, HoleFilling, Narrowing, Setting

if TYPE_CHECKING:
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.guidance import Guide


class Features(Narrowing, HoleFilling):
    """Nearest-neighbour (arXiv:2203.13215) or sliced Wasserstein (arXiv:2006.07229) matching of features."""

    name: Literal["features"] = "features"
    matching: Literal["nearest", "sliced"] = Field(
        default="nearest", description="each feature to its nearest, or both sets by sliced Wasserstein distance"
    )
    reference_windows: Count = Field(default=2, description="windows of other views that a patch is matched with")
    patch_size: Count = Field(default=64, description="rays along the side of a window")

    def cost(self) -> str:
        return "no UNet evaluation"

    def make_guide(self, to_fill: "tuple[MaskedView, ...]", setting: Setting) -> "Guide":  # noqa: ARG002
        from inpaint3d.stages.joint_optimization.feature_guide import FeatureGuide

        return FeatureGuide(
            to_fill,
            size=self.patch_size,
            matching=self.matching,
            reference_windows=self.reference_windows,
            min_known=self.min_known,
        )
