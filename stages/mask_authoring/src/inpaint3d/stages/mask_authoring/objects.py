"""An object pointed at on one view or more (M2), found in every view."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.kit.context import Context
from inpaint3d.contracts.models.artifacts.masks import ObjectPrompts, ObjectRequest
from inpaint3d.scene.morphology import remove_specks
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.mask_authoring.authored import Authored
from inpaint3d.stages.mask_authoring.carry import Carrying, carry
from inpaint3d.stages.mask_authoring.cloud import Cloud, splat
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.edges import enlarge, refine_edges
from inpaint3d.stages.mask_authoring.finish import finish
from inpaint3d.stages.mask_authoring.hull import carve
from inpaint3d.stages.mask_authoring.requests import find_view, object_prompts
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.segment import segment
from inpaint3d.stages.mask_authoring.surroundings import find_planes, find_surroundings
from inpaint3d.stages.mask_authoring.views import DepthView

Bools = NDArray[np.bool_]

MOST_OF_VIEW = 0.9  # an object that fills more of its view is the room
SPECKS = 0.02  # parts of an object's mask below this share of its largest are errors of depth


def author_object(request: ObjectRequest, scene: Scene, dilate: float, config: Config, ctx: Context) -> Authored:
    """Cut out where it was pointed at, carried to the other views with depth, held together by a voxel hull."""
    small = scene.small(config.segment_size)
    planes = find_planes(scene.points, small) if scene.planes is None else scene.planes
    found = {
        find_view(scene.views, prompts.view): segment_prompted(prompts, scene, config, ctx, planes)
        for prompts in request.prompts
    }
    around = find_surroundings(planes, scene.points, small, found, config.depth_tolerance)
    how = Carrying(config.depth_tolerance, config.margin, config.refine_rounds, ctx.seed, around)
    carried = carry(small, found, how, refine=config.refine, progress=ctx.progress)
    hull = carve(small, carried, voxels=config.voxels, agreement=config.agreement, tolerance=config.depth_tolerance)
    outlined = [
        remove_specks(outline(view, mask, hull, config, ctx.seed), SPECKS)
        for view, mask in zip(scene.depth_views, carried, strict=True)
    ]
    return Authored(
        origin="object",
        method=describe(request, scene, refine=config.refine),
        masks=[finish(m, dilate) for m in outlined],
        truth_masks=[
            finish(remove_specks(splat(v, hull, config.depth_tolerance), SPECKS), dilate) for v in scene.truth
        ],
    )


def segment_prompted(
    prompts: ObjectPrompts, scene: Scene, config: Config, ctx: Context, planes: Sequence[Plane] = ()
) -> Bools:
    """The object on the view that was pointed at -> bool [h, w] at the segmentation's size.

    planes: of the scene; those that are not pointed at, and reach far beyond what is, are no part of the object.
    Raises ConfigurationError where nothing is found, or all of the view.
    """
    found = cut_out(prompts, scene, config.segment_size, config, ctx.seed, planes)
    if not found.any():
        raise ConfigurationError(
            f"mask request: nothing was found at the points in view {prompts.view!r}; give more points on the object, "
            "points beside it under `background`, or a box round it; a part of a wall or of a floor is a `scribble`"
        )
    check_room_around(found, prompts.view)
    return found


def cut_out(
    prompts: ObjectPrompts, scene: Scene, longest: int, config: Config, seed: int, planes: Sequence[Plane] = ()
) -> Bools:
    """What was pointed at, as it is found on that view alone -> bool [h, w], at most `longest` pixels long."""
    source = find_view(scene.views, prompts.view)
    (small,) = Scene([scene.views[source]], [scene.depth_views[source]], [], scene.ordered).small(longest)
    camera = scene.views[source].camera
    given = object_prompts(prompts, camera)
    size = (small.camera.width, small.camera.height)
    if scene.segmenter is not None:
        found = scene.segmenter.segment(scene.views[source], given)
        return cv2.resize(found.astype(np.float32), size, interpolation=cv2.INTER_AREA) >= 0.5
    scaled = given.scaled(np.array(size) / (camera.width, camera.height))
    return segment(small, scaled, config.grabcut_rounds, seed, planes)


def check_room_around(found: Bools, view: str) -> None:
    """ConfigurationError where what was found fills the view: an object has something around it."""
    if found.mean() > MOST_OF_VIEW:
        raise ConfigurationError(
            f"mask request: what was found at the points fills {found.mean():.0%} of view {view!r}, so that nothing is "
            "left around it; give points beside the object under `background`, or a box round it"
        )


def outline(view: DepthView, carried: Bools, hull: Cloud, config: Config, seed: int) -> Bools:
    """The object at the picture's size: where the view's own mask and the hull agree, its outline as colours have it.

    An object of which they have nothing in common is left as the view's own mask has it.
    """
    own, held = enlarge(carried, view), splat(view, hull, config.depth_tolerance)
    agreed = own & held
    return refine_edges(view, agreed if agreed.any() else own, own | held, config.edge_rounds, seed)


def describe(request: ObjectRequest, scene: Scene, *, refine: bool) -> str:
    """How the masks are made, for the set's `method`."""
    given: Mapping[str, bool] = {
        "points": any(p.points for p in request.prompts),
        "a box": any(p.box is not None for p in request.prompts),
    }
    seeds = " and ".join(name for name, there in given.items() if there)
    views = ", ".join(p.view for p in request.prompts)
    found = f"{scene.segmenter.name} asked by" if scene.segmenter else "GrabCut on colour and depth seeded by"
    again = "segmented again" if scene.segmenter is None else "segmented by GrabCut"
    refined = f", {again} in each view" if refine else ""
    return (
        f"{found} {seeds} in {views}, reprojected with field depth and z-test{refined}, "
        "made consistent by a voxel hull, outlined by colour"
    )
