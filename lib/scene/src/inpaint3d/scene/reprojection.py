"""What one view shows, seen from another, by depth (z along the axis) and a test of who is in front."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.cameras import Camera

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


def correspondences(
    target: Camera,
    target_depth: ArrayLike,
    source: Camera,
    source_depth: ArrayLike | None = None,
    tolerance: float = 0.02,
) -> tuple[Floats, Bools]:
    """Where in `source` each target pixel's surface is: pixels [h, w, 2], and whether source sees it [h, w].

    Depths are z [h, w] in scene units; where they are not finite and positive there is no surface. The z-test asks
    that source's own depth there is the point's within `tolerance` of it (relative); without `source_depth` every
    point within the picture counts as seen.
    """
    z = np.asarray(target_depth, np.float64)
    surface = np.isfinite(z) & (z > 0)
    points = target.unproject(target.pixel_centres(), np.where(surface, z, 1.0))
    xy, z_source = source.project(points)
    seen = surface & source.inside(xy, z_source)
    if source_depth is not None:
        column, row = _find_pixel(source, xy, seen)
        own = np.asarray(source_depth, np.float64)[row, column]
        seen &= np.abs(np.where(np.isfinite(own), own, np.inf) - z_source) <= tolerance * np.abs(z_source)
    return xy, seen


def reproject_mask(
    mask: ArrayLike,
    source: Camera,
    source_depth: ArrayLike | None,
    target: Camera,
    target_depth: ArrayLike,
    tolerance: float = 0.02,
) -> tuple[Bools, Bools]:
    """Source's mask carried to target, [h, w], and which target pixels source can say anything of, [h, w]."""
    xy, seen = correspondences(target, target_depth, source, source_depth, tolerance)
    column, row = _find_pixel(source, xy, seen)
    return np.asarray(mask, bool)[row, column] & seen, seen


def warp_image(
    image: ArrayLike,
    source: Camera,
    source_depth: ArrayLike | None,
    target: Camera,
    target_depth: ArrayLike,
    tolerance: float = 0.02,
) -> tuple[NDArray[np.float32], Bools]:
    """Source's picture [h, w, c] seen from target (bilinear; 0 where unseen), and where it is seen [h, w]."""
    xy, seen = correspondences(target, target_depth, source, source_depth, tolerance)
    sampled = sample_bilinear(image, np.where(seen[..., None], xy, 0.5))
    return np.where(seen[..., None], sampled, np.float32(0)), seen


def sample_bilinear(image: ArrayLike, xy: ArrayLike) -> NDArray[np.float32]:
    """Values of `image` [h, w, c] at pixels `xy` [*n, 2] -> [*n, c]; outside, the border goes on."""
    image, xy = np.asarray(image, np.float32), np.asarray(xy, np.float64)
    height, width = image.shape[:2]
    x = np.clip(xy[..., 0] - 0.5, 0, width - 1)
    y = np.clip(xy[..., 1] - 0.5, 0, height - 1)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    x1, y1 = np.minimum(x0 + 1, width - 1), np.minimum(y0 + 1, height - 1)
    wx, wy = (x - x0)[..., None].astype(np.float32), (y - y0)[..., None].astype(np.float32)
    top = image[y0, x0] * (1 - wx) + image[y0, x1] * wx
    bottom = image[y1, x0] * (1 - wx) + image[y1, x1] * wx
    return (top * (1 - wy) + bottom * wy).astype(np.float32)


def sparse_depth(camera: Camera, xyz: ArrayLike) -> Floats:
    """Depth z [h, w] of the nearest of the points [p, 3] in each pixel; inf where there is none."""
    depth = np.full((camera.height, camera.width), np.inf)
    xy, z = camera.project(xyz)
    inside = camera.inside(xy, z)
    column, row = xy[inside].astype(np.int64).T
    np.minimum.at(depth, (row, column), z[inside])
    return depth


def _find_pixel(camera: Camera, xy: Floats, usable: Bools) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Column and row of the pixels that hold `xy`; pixel (0, 0) stands in where it is not usable."""
    held = np.where(usable[..., None], xy, 0.0).astype(np.int64)
    return np.clip(held[..., 0], 0, camera.width - 1), np.clip(held[..., 1], 0, camera.height - 1)
