"""Masks as the page shows them: at once on the view that is looked at, as outlines that a browser draws."""

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.masks import (
    BoxRequest,
    ImportedRequest,
    ObjectRequest,
    OutpaintRequest,
    ScribbleRequest,
    SphereRequest,
    SurfaceClick,
    UnionRequest,
    list_parts,
)
from inpaint3d.scene.volumes import volume_mask
from inpaint3d.stages.mask_authoring.author import Request
from inpaint3d.stages.mask_authoring.config import Config
from inpaint3d.stages.mask_authoring.objects import cut_out
from inpaint3d.stages.mask_authoring.page.pictures import Subject, fit_size
from inpaint3d.stages.mask_authoring.requests import find_view, object_prompts, scribble_path, surface_pixel
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.scribble import draw
from inpaint3d.stages.mask_authoring.volumes import place

Bools = NDArray[np.bool_]
Outline = list[list[float]]
"""Closed polygons, each x0, y0, x1, y1, ... in pixels of the page's picture; what an odd number of them hold is in."""

AT_ONCE_SIDE = 192  # pixels; what GrabCut shows at once is cut out on a smaller picture than what is carried
SMOOTH_SIDE = 640  # pixels; masks are enlarged to this before their outline is taken
SIMPLER = 0.6  # pixels of that size by which an outline may differ from the mask's


def mask_at_once(request: Request, subject: Subject, view: str, config: Config, seed: int) -> Bools | None:
    """The mask that a request gives on one view, bool [h, w] of some size; None where only carrying can tell.

    ConfigurationError where the request cannot work.
    """
    scene = subject.scene
    index = find_view(scene.views, view)
    match request:
        case ObjectRequest():
            given = next((prompts for prompts in request.prompts if prompts.view == view), None)
            longest = AT_ONCE_SIDE if scene.segmenter is None else SMOOTH_SIDE
            return None if given is None else cut_out(given, scene, longest, config, seed)
        case ScribbleRequest():
            return _draw(request, scene, seed) if request.view == view else None
        case SphereRequest() | BoxRequest() | OutpaintRequest():
            return volume_mask(scene.depth_views[index].camera, place(request, scene))
        case UnionRequest():
            parts = [mask_at_once(part, subject, view, config, seed) for part in request.of]
            known = [mask for mask in parts if mask is not None]
            return np.logical_or.reduce(known) if len({mask.shape for mask in known}) == 1 else None
        case ImportedRequest():
            return scene.views[index].mask()
        case _:
            return None


def check_request(request: Request, subject: Subject) -> None:
    """ConfigurationError where the request points at no view, or outside of one."""
    views = subject.scene.views
    for part in list_parts(request):
        match part:
            case ObjectRequest():
                for prompts in part.prompts:
                    object_prompts(prompts, views[find_view(views, prompts.view)].camera)
            case ScribbleRequest():
                scribble_path(part, views[find_view(views, part.view)].camera)
            case SphereRequest(surface=SurfaceClick() as click) | BoxRequest(surface=SurfaceClick() as click):
                surface_pixel(click, views[find_view(views, click.view)].camera)
            case _:
                pass


def trace_outline(mask: Bools, width: int, height: int) -> Outline:
    """The outline of a mask bool [h, w] in a picture of `width` x `height` pixels."""
    size = fit_size(width, height, SMOOTH_SIDE)
    smooth = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_LINEAR) >= 0.5
    contours, _ = cv2.findContours(smooth.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    scale = np.array([width / size[0], height / size[1]])
    simple = (cv2.approxPolyDP(contour, SIMPLER, True)[:, 0] for contour in contours)
    return [[round(float(v), 1) for v in ((points + 0.5) * scale).ravel()] for points in simple if len(points) > 2]


def _draw(request: ScribbleRequest, scene: Scene, seed: int) -> Bools:
    view = scene.depth_views[find_view(scene.views, request.view)]
    width, height = view.camera.width, view.camera.height
    path = scribble_path(request, view.camera)
    return draw(path, width, height, request.thickness * min(width, height), seed)
