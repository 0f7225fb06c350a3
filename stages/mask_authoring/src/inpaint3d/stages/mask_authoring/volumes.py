"""Volume masks (M1, M4): where a request puts its sphere or box."""

import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import Primitive
from inpaint3d.contracts.models.artifacts.masks import BoxRequest, OutpaintRequest, SphereRequest
from inpaint3d.scene.volumes import box, sphere
from inpaint3d.stages.mask_authoring.segment import middle_depth
from inpaint3d.stages.mask_authoring.views import DepthView, camera_distances


def place(request: SphereRequest | BoxRequest | OutpaintRequest, views: list[DepthView], *, ordered: bool) -> Primitive:
    """The volume in scene units. Fractions are of the median depth that the centre view sees."""
    if isinstance(request, BoxRequest):
        return box(request.centre, request.size, request.yaw_deg)
    if isinstance(request, SphereRequest) and request.centre is not None:
        return sphere(request.centre, request.radius)
    view = views[centre_view(views, ordered=ordered)]
    depth = middle_depth(view.depth)
    if depth is None:
        raise BadInputError(
            f"the field has no surface in the centre view {view.name}, so that a distance as a fraction of its depth "
            "means nothing; train it longer (nerf-pretraining), or give the sphere's centre in scene units"
        )
    centre = view.camera.centre + view.camera.forward * depth * request.distance
    return sphere(centre, depth * request.radius, inverted=isinstance(request, OutpaintRequest))


def centre_view(views: list[DepthView], *, ordered: bool) -> int:
    """The middle of the camera's path; of photos without an order, the one nearest to all others."""
    if ordered:
        return len(views) // 2
    return int(np.argmin(camera_distances([v.camera for v in views]).sum(0)))
