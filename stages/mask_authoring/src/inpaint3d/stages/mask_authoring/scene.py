"""What masks are authored on."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import PosedCapture, PosedTruth, RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.capture_io import View, load_points
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.mask_authoring.sam import SegmentAnything
from inpaint3d.stages.mask_authoring.truth import truth_views
from inpaint3d.stages.mask_authoring.views import DepthView, load_depth_views


@dataclass(frozen=True, eq=False)
class Scene:
    """The posed views, the same with the field's depth, and the truth cameras with depth from the views around them."""

    views: list[View]
    depth_views: list[DepthView]
    truth: list[DepthView]
    ordered: bool
    points: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    """Sparse points [n, 3], scene units: where the scene is flat. Without them no wall and no floor is known."""
    segmenter: SegmentAnything | None = None
    """What cuts an object out where it is pointed at; None: GrabCut."""

    planes: Sequence[Plane] | None = None
    """Of the sparse points, where they have been found already; they depend on no request."""

    def small(self, longest: int) -> list[DepthView]:
        """The views with pictures of at most `longest` pixels."""
        return [_shrink(v, longest) for v in self.depth_views]


def load_scene(
    posed: Artifact[PosedCapture], field: Artifact[RadianceFieldArtifact], truth: Artifact[PosedTruth] | None = None
) -> Scene:
    """A capture with its pretrained field. BadInputError where the field lacks a view."""
    views, depth_views = load_depth_views(posed, field)
    unseen = truth_views(truth, depth_views) if truth else []
    points = load_points(posed.path(posed.metadata.points)).xyz
    return Scene(views, depth_views, unseen, posed.metadata.ordered, points)


def _shrink(view: DepthView, longest: int) -> DepthView:
    width, height = view.camera.width, view.camera.height
    scale = longest / max(width, height)
    return view if scale >= 1 else view.resized(max(1, round(width * scale)), max(1, round(height * scale)))
