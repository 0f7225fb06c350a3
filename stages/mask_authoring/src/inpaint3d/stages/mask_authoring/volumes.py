"""Volume masks (M1, M4): where a request puts its sphere or box."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError, ConfigurationError
from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.contracts.models.artifacts.masks import BoxRequest, OutpaintRequest, SphereRequest, SurfaceClick
from inpaint3d.scene.volumes import box, sphere
from inpaint3d.stages.mask_authoring.requests import find_view, surface_pixel
from inpaint3d.stages.mask_authoring.scene import Scene
from inpaint3d.stages.mask_authoring.segment import middle_depth
from inpaint3d.stages.mask_authoring.views import DepthView, camera_distances

VolumeRequest = SphereRequest | BoxRequest | OutpaintRequest


def place(request: VolumeRequest, scene: Scene) -> Primitive:
    """The volume in scene units. Fractions are of the median depth that the centre view sees, or of a click's depth."""
    match request:
        case BoxRequest(surface=SurfaceClick() as click):
            centre, depth = find_surface(click, scene)
            return box(centre, np.multiply(request.size, depth), request.yaw_deg)
        case BoxRequest(centre=centre) if centre is not None:
            return box(centre, request.size, request.yaw_deg)
        case SphereRequest(surface=SurfaceClick() as click):
            centre, depth = find_surface(click, scene)
            return sphere(centre, depth * request.radius)
        case SphereRequest(centre=centre) if centre is not None:
            return sphere(centre, request.radius)
        case SphereRequest() | OutpaintRequest():
            return place_on_axis(request, scene.depth_views, ordered=scene.ordered)
    raise ConfigurationError("mask request: a box needs `centre` in scene units, or `surface`, a click on a view")


def place_on_axis(request: SphereRequest | OutpaintRequest, views: list[DepthView], *, ordered: bool) -> Primitive:
    """A sphere on the centre view's axis, in fractions of the median depth there."""
    view = views[centre_view(views, ordered=ordered)]
    depth = middle_depth(view.depth)
    if depth is None:
        raise BadInputError(
            f"the field has no surface in the centre view {view.name}, so that a distance as a fraction of its depth "
            "means nothing; train it longer (nerf-pretraining), or give the sphere's centre in scene units"
        )
    centre = view.camera.centre + view.camera.forward * depth * request.distance
    return sphere(centre, depth * request.radius, inverted=isinstance(request, OutpaintRequest))


def find_surface(click: SurfaceClick, scene: Scene) -> tuple[NDArray[np.float64], float]:
    """The point [3] of the field's surface that was clicked at, and its depth along the axis, scene units."""
    view = scene.depth_views[find_view(scene.views, click.view)]
    pixel = surface_pixel(click, view.camera)
    depth = float(view.depth_at(pixel))
    if not np.isfinite(depth):
        raise ConfigurationError(
            f"mask request: the field has no surface at {list(click.at)} in view {click.view!r}; click beside it, or "
            "give `centre` in scene units"
        )
    return view.camera.unproject(pixel, depth), depth


def centre_view(views: list[DepthView], *, ordered: bool) -> int:
    """The middle of the camera's path; of photos without an order, the one nearest to all others."""
    if ordered:
        return len(views) // 2
    return int(np.argmin(camera_distances([v.camera for v in views]).sum(0)))
