"""Fits the pictures that view-completion made: their colours ray by ray, their detail by LPIPS in small windows."""

from dataclasses import replace
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.base import Share
from inpaint3d.radiance.fitting import Weight
from inpaint3d.stages.joint_optimization.estimators.base import PULLING, Count, Guided, Preparation, Setting

if TYPE_CHECKING:
    from inpaint3d.contracts.models.artifacts import CompletedViews
    from inpaint3d.contracts.store import Artifact
    from inpaint3d.scene.masked_views import MaskedView
    from inpaint3d.stages.joint_optimization.batch import Filled
    from inpaint3d.stages.joint_optimization.guidance import Guide

PORT = "completed-views"


class CompletedViewsEstimator(Guided):
    """Completed views as what the hole shows. No prior is asked."""

    reads: ClassVar[tuple[str, ...]] = (PORT,)

    name: Literal["completed-views"] = "completed-views"
    weight: Weight = Field(default=0.6, description="peak weight of LPIPS in the hole; 0: rays alone")
    distill_every: Count = Field(default=4, description="steps from one window to the next", json_schema_extra=PULLING)
    filled_share: Share | None = Field(
        default=0.4,
        description="share of the rays of a step that are drawn from what was filled; None: as many as fall on it; "
        "0: LPIPS alone",
    )
    windows: Literal["random", "whole-hole"] = Field(
        default="random",
        description="where LPIPS looks: anywhere on the hole, or in one window a view over most of it",
        json_schema_extra=PULLING,
    )
    span: Share = Field(
        default=0.3,
        description="side of the windows, share of the short side: small, for detail",
        json_schema_extra=PULLING,
    )
    patch_size: Count = Field(default=64, description="rays along the side of a window", json_schema_extra=PULLING)

    def label(self, *, continued: bool, completion: str | None) -> str:  # noqa: ARG002 - the pictures make the name
        if completion == "classical":
            return "classical-then-nerf"
        return "inpaint-then-nerf" if completion == "prior-samples" else f"joint-{completion or self.name}"

    def span_at(self, since: int, total: int) -> float:  # noqa: ARG002 - windows stay as large
        return self.span

    def prepare(self, setting: Setting) -> Preparation:
        from inpaint3d.contracts.models.artifacts import CompletedViews
        from inpaint3d.scene.masked_views import find_fillable

        completed = setting.inputs.optional(PORT, CompletedViews)
        if completed is None:
            raise ConfigurationError(
                f"estimator {self.name!r} fits what view-completion made, and nothing is wired to the input {PORT}; "
                "wire it, or choose another estimator"
            )
        filled = load_filled(completed, setting)
        reasons = {"hole": completed.metadata.summary, "cost": "no UNet evaluation"}
        if not find_fillable(filled.views):
            raise BadInputError(
                "no training view shows both a filled hole and something known around it; author another mask"
            )
        alike = _share_exposure(tuple(filled.views), setting)
        guide = self._make_guide(alike) if self.weight else None
        return Preparation(alike, guide, None if self.filled_share == 0 else filled, reasons)

    def _make_guide(self, views: "tuple[MaskedView, ...]") -> "Guide":
        from inpaint3d.scene.windows import choose_fixed_windows
        from inpaint3d.stages.joint_optimization.guidance import PictureGuide

        windows = None
        if self.windows == "whole-hole":
            windows = choose_fixed_windows(views, size=self.patch_size, span=self.span, min_known=self.min_known)
        return PictureGuide([v.image for v in views], self.patch_size, windows)


def load_filled(completed: "Artifact[CompletedViews]", setting: Setting) -> "Filled":
    """The training views with their holes filled: `hole` is what was filled. BadInputError for another capture's."""
    from inpaint3d.radiance.line_of_sight import SightLines
    from inpaint3d.scene.image_io import read_image
    from inpaint3d.scene.map_io import read_codes, read_exr
    from inpaint3d.scene.visibility import pool_any
    from inpaint3d.stages.joint_optimization.batch import Filled

    by_name = {v.name: v for v in completed.metadata.views}
    views, surfaces = [], []
    for view in setting.scene.train:
        if (one := by_name.get(view.name)) is None:
            raise BadInputError(f"the completed views have no view {view.name}; re-run view-completion on this capture")
        picture, hole = read_image(completed.path(one.picture)), read_codes(completed.path(one.sources)) > 0
        if picture.shape[:2] != view.hole.shape or hole.shape != view.hole.shape:
            raise BadInputError(
                f"completed view {view.name} is {picture.shape[1]}x{picture.shape[0]}, the view itself "
                f"{view.camera.width}x{view.camera.height}; re-run view-completion on this capture"
            )
        views.append(replace(view, image=picture, hole=hole & view.hole))
        if one.depth is not None:
            depth = read_exr(completed.path(one.depth))["depth.Z"]
            h, w = depth.shape
            surfaces.append((view.camera.resize_to(w, h), depth, pool_any(views[-1].hole, h, w)))
    return Filled(views, SightLines.of_surfaces(surfaces, setting.device) if surfaces else None)


def _share_exposure(views: "tuple[MaskedView, ...]", setting: Setting) -> "tuple[MaskedView, ...]":
    """The views in the mean appearance, which is what renders of the hole show."""
    from inpaint3d.radiance.appearance import AppearanceMap

    appearance = AppearanceMap(setting.field)
    return tuple(replace(v, image=appearance.to_mean(v.image, i)) for i, v in enumerate(views))
