"""Masks as the page shows them: at once on the view that is looked at, as outlines that a browser draws."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts.masks import (
    BoxRequest,
    ObjectRequest,
    OutpaintRequest,
    ScribbleRequest,
    SphereRequest,
)
from inpaint3d.scene.volumes import volume_mask
from inpaint3d.stages.mask_authoring.author import Request, Scene
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.page.pictures import Subject, fit_size
from inpaint3d.stages.mask_authoring.requests import find_view, object_prompts, scribble_path
from inpaint3d.stages.mask_authoring.scribble import draw
from inpaint3d.stages.mask_authoring.segment import segment
from inpaint3d.stages.mask_authoring.volumes import place

Bools = NDArray[np.bool_]
Outline = list[list[float]]
"""Closed polygons, each x0, y0, x1, y1, ... in pixels of the page's picture; what an odd number of them hold is in."""

AT_ONCE_SIDE = 192  # pixels; what is shown at once is cut out on a smaller picture than what is carried
SMOOTH_SIDE = 640  # pixels; masks are enlarged to this before their outline is taken
SIMPLER = 0.6  # pixels of that size by which an outline may differ from the mask's


def mask_at_once(request: Request, subject: Subject, view: int, config: Config, seed: int) -> Bools | None:
    """The mask that a request gives on one view, bool [h, w] of some size; None where only carrying can tell.

    ConfigurationError where the request cannot work.
    """
    scene = subject.scene
    match request:
        case ObjectRequest():
            return _cut_out(request, scene, config, seed) if find_view(scene.views, request.view) == view else None
        case ScribbleRequest():
            return _draw(request, scene, seed) if find_view(scene.views, request.view) == view else None
        case SphereRequest() | BoxRequest() | OutpaintRequest():
            primitive = place(request, scene.depth_views, ordered=scene.ordered)
            return volume_mask(scene.depth_views[view].camera, primitive)
        case _:
            return scene.views[view].mask()


def check_request(request: Request, subject: Subject) -> None:
    """ConfigurationError where the request points outside the pictures, or at nothing."""
    views = subject.scene.views
    if isinstance(request, ObjectRequest):
        object_prompts(request, views[find_view(views, request.view)].camera)
    elif isinstance(request, ScribbleRequest):
        scribble_path(request, views[find_view(views, request.view)].camera)


def find_surface(subject: Subject, view: int, x: float, y: float) -> tuple[list[float], float]:
    """The point of the surface under a pixel of the page's picture [3], and its depth, both in scene units.

    ConfigurationError where the field has no surface there.
    """
    seen = subject.scene.depth_views[view]
    width, height = subject.picture_size(view)
    xy = np.array([x * seen.camera.width / width, y * seen.camera.height / height])
    depth = float(seen.depth_at(xy))
    if not np.isfinite(depth):
        raise ConfigurationError("there is no surface at this point; click on a thing that the field shows")
    return [float(v) for v in seen.camera.unproject(xy, depth)], depth


def trace_outline(mask: Bools, width: int, height: int) -> Outline:
    """The outline of a mask bool [h, w] in a picture of `width` x `height` pixels."""
    size = fit_size(width, height, SMOOTH_SIDE)
    smooth = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) >= 0.5
    contours, _ = cv2.findContours(smooth.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    scale = np.array([width / size[0], height / size[1]])
    simple = (cv2.approxPolyDP(contour, SIMPLER, True)[:, 0] for contour in contours)
    return [[round(float(v), 1) for v in ((points + 0.5) * scale).ravel()] for points in simple if len(points) > 2]


def _cut_out(request: ObjectRequest, scene: Scene, config: Config, seed: int) -> Bools:
    source = find_view(scene.views, request.view)
    camera, view = scene.views[source].camera, scene.depth_views[source]
    small = view.resized(*fit_size(view.camera.width, view.camera.height, AT_ONCE_SIDE))
    factor = np.array([small.camera.width / camera.width, small.camera.height / camera.height])
    return segment(small, object_prompts(request, camera).scaled(factor), config.grabcut_rounds, seed)


def _draw(request: ScribbleRequest, scene: Scene, seed: int) -> Bools:
    view = scene.depth_views[find_view(scene.views, request.view)]
    width, height = view.camera.width, view.camera.height
    path = scribble_path(request, view.camera)
    return draw(path, width, height, request.thickness * min(width, height), seed)
