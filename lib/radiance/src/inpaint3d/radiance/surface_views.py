"""What a field looks like from the capture's cameras: colour and depth, stored or rendered."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import FieldView, RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.artifact import reduce_camera
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image, read_image
from inpaint3d.scene.map_io import read_exr

DOME = 12.0  # scene units; radius about the origin. Cameras are within the unit ball: little parallax is left there

Render = Callable[[Camera], dict[str, NDArray[np.float32]]]


@dataclass(frozen=True, eq=False)
class SurfaceView:
    """Colour [h, w, 3] and depth along the axis [h, w] of the first surface; 0 where there is none."""

    camera: Camera
    rgb: Image
    depth: NDArray[np.float32]


def surface_view(
    field: Artifact[RadianceFieldArtifact],
    name: str,
    camera: Camera,
    render: Render,
    *,
    longest_side: int,
    opaque: float,
) -> SurfaceView:
    """The view that the field's artifact holds, if it is big enough, else a fresh render.

    The surface lies at the median depth: the mean of a ray that grazes an edge lies in the air between two
    surfaces.
    """
    small = reduce_camera(camera, longest_side)
    stored = next((v for v in field.metadata.views if v.name == name), None)
    if stored is not None and (found := _read_stored(field, stored, camera, max(small.width, small.height))):
        rgb, depth, opacity = found
    else:
        maps = render(small)
        rgb, depth, opacity = maps["rgb"], maps["median_depth"], maps["opacity"]
    surface = np.isfinite(depth) & (depth > 0) & (opacity >= opaque) & np.isfinite(rgb).all(-1)
    # A pixel that is not finite has no surface and no colour, and is never read again.
    colour = np.where(surface[..., None], rgb, 0).astype(np.float32)
    height, width = depth.shape
    return SurfaceView(camera.resize_to(width, height), colour, np.where(surface, depth, 0).astype(np.float32))


def close_off(view: SurfaceView) -> SurfaceView:
    """The view with a dome behind everything: what shows no surface, or a farther one, shows the dome."""
    camera = view.camera
    origins, directions = camera.rays()
    along = (origins * directions).sum(-1)
    distance = -along + np.sqrt(np.square(along) - np.square(origins).sum(-1) + DOME**2)
    dome = distance * (directions @ camera.forward)
    depth = np.where(view.depth > 0, np.minimum(view.depth, dome), dome)
    return replace(view, depth=depth.astype(np.float32))


def _read_stored(
    field: Artifact[RadianceFieldArtifact], view: FieldView, camera: Camera, longest_side: int
) -> tuple[Image, NDArray[np.float32], NDArray[np.float32]] | None:
    maps = read_exr(field.path(view.maps))
    depth, opacity = maps["median.Z"], maps["opacity.A"]
    rgb = read_image(field.path(view.picture))
    # Stored renders of other proportions show a part of the view, by a camera that is not stored: they cannot be used.
    same_shape = abs(depth.shape[1] / depth.shape[0] - camera.width / camera.height) < 0.05
    if max(depth.shape) < longest_side or not same_shape or rgb.shape[:2] != depth.shape:
        return None
    return rgb, depth, opacity
