"""The capture as completion and optimisation may see it: pictures blanked under the mask as soon as they are read."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import EffectPlan, MaskSet, MaskView, PosedCapture
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints, load_points, load_posed
from inpaint3d.scene.evidence_masks import IgnoredPixels
from inpaint3d.scene.image_io import Mask, read_mask


@dataclass(frozen=True, eq=False)
class MaskedView:
    """image: sRGB-encoded float32 [h, w, 3], 0 where not `known`; hole, known: bool [h, w].

    A pixel is neither where undistortion left the picture empty outside the hole.
    """

    name: str
    camera: Camera
    image: NDArray[np.float32]
    hole: Mask
    known: Mask

    @property
    def hole_share(self) -> float:
        return float(self.hole.mean())


@dataclass(frozen=True, eq=False)
class MaskedScene:
    """Views to fit, views kept back to score the known pixels, and the sparse points that no mask covers.

    order: names of the frames that the points' tracks count by.
    """

    train: tuple[MaskedView, ...]
    test: tuple[MaskedView, ...]
    sparse: SparsePoints
    order: tuple[str, ...]

    @property
    def points(self) -> NDArray[np.float32]:
        """[p, 3] in scene units."""
        return self.sparse.xyz


def load_masked_scene(
    posed: Artifact[PosedCapture],
    masks: Artifact[MaskSet],
    plan: Artifact[EffectPlan] | None = None,
    *,
    whole_frames: bool = True,
    whole_mask: bool = False,
) -> MaskedScene:
    """Every posed view with its mask. BadInputError where a mask is missing, misshapen or leaves nothing known.

    The hole is what the mask set says: all of the mask, or what of it no other view shows; the rest of the mask is then
    neither hole nor known. whole_mask: all of the mask, whatever it says. Neither hole nor known is what the plan's
    effects take out of the evidence, too (`IgnoredPixels`).
    """
    ignored = IgnoredPixels(plan, whole_frames=whole_frames)
    whole = whole_mask or masks.metadata.hole == "object"
    by_name = {m.name: m for m in masks.metadata.views}
    views: dict[str, list[MaskedView]] = {"train": [], "test": []}
    covered: dict[str, Mask] = {}
    for view in load_posed(posed):
        if (mask := by_name.get(view.name)) is None:
            raise BadInputError(f"the mask set has no mask for view {view.name}; re-run mask-authoring on this capture")
        size = (view.camera.width, view.camera.height)
        masked = read_mask(masks.path(mask.mask), size)
        known = ignored.take_from(view.valid() & ~masked, view.name, view.camera)
        # Blanked when the view is read, so that no later code can use masked pixels, not even by mistake.
        image = np.where(known[..., None], view.image(), np.float32(0))
        covered[view.name] = masked
        own = masked if whole else masked & read_mask(masks.path(_find_unseen(mask)), size)
        views[view.split].append(MaskedView(view.name, view.camera, image, own, known))
    if not any(v.known.any() for v in views["train"]):
        raise BadInputError("the masks cover every training pixel; author a smaller mask")
    points = load_points(posed.path(posed.metadata.points))
    order = tuple(f.name for f in posed.metadata.frames)
    unmasked = find_unmasked(points, [covered[name] for name in order])
    return MaskedScene(tuple(views["train"]), tuple(views["test"]), points.select(unmasked), order)


def _find_unseen(mask: MaskView) -> str:
    if mask.unseen is None:
        raise BadInputError(
            f"the mask set does not say what of view {mask.name}'s mask no other view shows; run mask-authoring again"
        )
    return mask.unseen


def find_unmasked(points: SparsePoints, holes: Sequence[Mask]) -> Mask:
    """Which points, bool [p], were never seen under a mask; `holes` are those of the frames that tracks count by."""
    covered = np.zeros(len(points), bool)
    xy = np.floor(points.track_xy).astype(np.int64)
    for frame, hole in enumerate(holes):
        rows = points.track_frame == frame
        x, y = xy[rows, 0].clip(0, hole.shape[1] - 1), xy[rows, 1].clip(0, hole.shape[0] - 1)
        covered[points.track_point[rows][hole[y, x]]] = True
    return ~covered


def find_fillable(views: Sequence[MaskedView]) -> list[int]:
    """Indices of the views that show both the hole and something known around it."""
    return [i for i, v in enumerate(views) if v.hole.any() and v.known.any()]
