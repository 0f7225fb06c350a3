"""Each kind of request, turned into a mask for every posed view and every truth camera."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts.masks import (
    BoxRequest,
    ImportedRequest,
    ObjectRequest,
    OutpaintRequest,
    ScribbleRequest,
    SphereRequest,
)
from inpaint3d.scene.capture_io import View
from inpaint3d.scene.morphology import close, fill_holes, grow, remove_specks
from inpaint3d.scene.volumes import volume_mask
from inpaint3d.stages.mask_authoring.authored import Authored
from inpaint3d.stages.mask_authoring.carry import Carrying, carry
from inpaint3d.stages.mask_authoring.cloud import lift, splat
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.hull import carve
from inpaint3d.stages.mask_authoring.requests import find_view, object_prompts, scribble_path
from inpaint3d.stages.mask_authoring.scribble import draw, random_path
from inpaint3d.stages.mask_authoring.segment import segment
from inpaint3d.stages.mask_authoring.views import DepthView
from inpaint3d.stages.mask_authoring.volumes import place

Bools = NDArray[np.bool_]
VolumeRequest = SphereRequest | BoxRequest | OutpaintRequest
Request = VolumeRequest | ObjectRequest | ScribbleRequest | ImportedRequest

CLOSING = 0.01  # of the shorter side
MOST_OF_VIEW = 0.9  # an object that fills more of its view is the room
SPECKS = 0.02  # parts of an object's mask below this share of its largest are errors of depth
HOLES = 0.05  # enclosed gaps up to this share of the mask are filled
# Share of a pixel's neighbourhood that must be masked where a mask is enlarged. Under a half, since a rim of the object
# that is left spoils its removal.
KEPT = 0.3


@dataclass(frozen=True, eq=False)
class Scene:
    """What masks are authored on: the posed views, the same with the field's depth, and the truth cameras."""

    views: list[View]
    depth_views: list[DepthView]
    truth: list[DepthView]
    ordered: bool

    def small(self, longest: int) -> list[DepthView]:
        """The views with pictures of at most `longest` pixels."""
        return [_shrink(v, longest) for v in self.depth_views]


def author(request: Request, scene: Scene, dilate: float, config: Config, ctx: Context) -> Authored:
    """Masks for a request. `dilate` is a share of the shorter side; volumes are exact and not grown."""
    match request:
        case ObjectRequest():
            return author_object(request, scene, dilate, config, ctx)
        case ScribbleRequest():
            return author_scribble(request, scene, dilate, config, ctx)
        case ImportedRequest():
            return author_imported(scene, dilate, config)
        case _:
            return author_volume(request, scene)


def author_volume(request: VolumeRequest, scene: Scene) -> Authored:
    """M1, M4: each pixel's ray against the volume."""
    primitive = place(request, scene.depth_views, ordered=scene.ordered)
    return Authored(
        origin=request.kind,
        method=f"rays against {'the outside of ' if primitive.inverted else ''}a {primitive.kind}, exact in every view",
        masks=[volume_mask(v.camera, primitive) for v in scene.depth_views],
        truth_masks=[volume_mask(v.camera, primitive) for v in scene.truth],
        primitives=(primitive,),
    )


def author_object(request: ObjectRequest, scene: Scene, dilate: float, config: Config, ctx: Context) -> Authored:
    """M2: cut out on the request's view, carried to the others with depth, made consistent by a voxel hull."""
    source = find_view(scene.views, request.view)
    small = scene.small(config.segment_size)
    camera, shown = scene.views[source].camera, small[source].camera
    prompts = object_prompts(request, camera)
    prompts = prompts.scaled(np.array([shown.width / camera.width, shown.height / camera.height]))
    found = segment(small[source], prompts, config.grabcut_rounds, ctx.seed)
    if not found.any():
        raise ConfigurationError(
            f"mask request: nothing was found at the points in view {request.view!r}; give more points on the object, "
            "points beside it under `background`, or a box round it"
        )
    check_room_around(found, request.view)
    how = Carrying(config.depth_tolerance, config.margin, config.refine_rounds, ctx.seed)
    carried = carry(small, source, found, how, refine=config.refine, progress=ctx.progress)
    hull = carve(small, carried, voxels=config.voxels, agreement=config.agreement, tolerance=config.depth_tolerance)
    masks = []
    for view, mask in zip(scene.depth_views, carried, strict=True):
        shown = splat(view, hull, config.depth_tolerance) | _enlarge(mask, view)
        masks.append(_finish(remove_specks(shown, SPECKS), dilate))
    seeds = " and ".join(n for n, given in (("points", request.points), ("a box", request.box)) if given)
    refined = ", segmented again in each view" if config.refine else ""
    return Authored(
        origin="object",
        method=f"GrabCut on colour and depth seeded by {seeds} in {request.view}, reprojected with field depth and "
        f"z-test{refined}, made consistent by a voxel hull",
        masks=masks,
        truth_masks=[
            _finish(remove_specks(splat(v, hull, config.depth_tolerance), SPECKS), dilate) for v in scene.truth
        ],
    )


def check_room_around(found: Bools, view: str) -> None:
    """ConfigurationError where what was found fills the view: an object has something around it."""
    if found.mean() > MOST_OF_VIEW:
        raise ConfigurationError(
            f"mask request: what was found at the points fills {found.mean():.0%} of view {view!r}, so that nothing is "
            "left around it; give points beside the object under `background`, or a box round it"
        )


def author_scribble(request: ScribbleRequest, scene: Scene, dilate: float, config: Config, ctx: Context) -> Authored:
    """M3: a path widened by ellipses on one view, its surface shown in the others."""
    source = find_view(scene.views, request.view)
    view = scene.depth_views[source]
    width, height = view.camera.width, view.camera.height
    path = scribble_path(request, view.camera) if request.path else random_path(width, height, ctx.seed)
    drawn = draw(path, width, height, request.thickness * min(width, height), ctx.seed)
    surface = lift(view, drawn)
    if not len(surface):
        raise BadInputError(
            f"the field has no surface under the scribble in view {request.view!r}; draw it elsewhere, or train the "
            "field longer (nerf-pretraining)"
        )
    shown = [splat(v, surface, config.depth_tolerance) for v in (*scene.depth_views, *scene.truth)]
    shown[source] |= drawn
    finished = [_finish(m, dilate) for m in shown]
    count = len(scene.depth_views)
    drawn_by = "hand" if request.path else "chance"
    return Authored(
        origin="scribble",
        method=f"path drawn by {drawn_by} in {request.view}, widened by ellipses, reprojected with field depth",
        masks=finished[:count],
        truth_masks=finished[count:],
    )


def author_imported(scene: Scene, dilate: float, config: Config) -> Authored:
    """M5: the capture's own masks; views without one get what the others outline in space."""
    given = [v.mask() for v in scene.views]
    known = [(v, m) for v, m in zip(scene.depth_views, given, strict=True) if m is not None]
    if not known:
        raise ConfigurationError(
            "mask request: `imported` asks for the capture's own masks, but none of its views has one; put them in "
            "masks/ beside images/, with the same stems, or describe the mask in another way"
        )
    masks, truth_masks, carried = given, [], ""
    if scene.truth or len(known) < len(given):
        views, own = [v for v, _ in known], [m for _, m in known]
        hull = carve(views, own, voxels=config.voxels, agreement=config.agreement, tolerance=config.depth_tolerance)
        shown = [splat(v, hull, config.depth_tolerance) for v in scene.depth_views]
        masks = [s if m is None else m for m, s in zip(given, shown, strict=True)]
        truth_masks = [splat(v, hull, config.depth_tolerance) for v in scene.truth]
        carried = f"; {len(given) - len(known)} views without one from a voxel hull"
    return Authored(
        origin="imported",
        method=f"masks of the capture for {len(known)} of {len(given)} views{carried}",
        masks=[_finish(m, dilate) for m in masks if m is not None],
        truth_masks=[_finish(m, dilate) for m in truth_masks],
    )


def _finish(mask: Bools, dilate: float) -> Bools:
    """Closed, small holes filled, grown by a share of the shorter side (M2: holes filled, edges smoothed)."""
    side = min(mask.shape)
    closed = fill_holes(close(mask, max(1, round(CLOSING * side))), HOLES)
    return grow(closed, round(dilate * side))


def _shrink(view: DepthView, longest: int) -> DepthView:
    width, height = view.camera.width, view.camera.height
    scale = longest / max(width, height)
    return view if scale >= 1 else view.resized(max(1, round(width * scale)), max(1, round(height * scale)))


def _enlarge(mask: Bools, view: DepthView) -> Bools:
    """A mask from the segmentation's size to the picture's."""
    size = (view.camera.width, view.camera.height)
    return cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) >= KEPT
