"""What a method has to beat: pictures made without a learned scene."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.morphology import grow_square
from inpaint3d.scene.reprojection import reproject_mask, sample_bilinear, warp_image
from inpaint3d.stages.evaluation.photos import Photo, camera_distance

LATTICE = 4  # pixels between the places where sparse depth is interpolated


def ring_around(mask: Mask, radius: int) -> Mask:
    """Pixels outside the mask [h, w] that lie at most `radius` rows and columns from it."""
    return grow_square(mask, radius) & ~mask


def mean_surround(image: Image, mask: Mask, radius: int) -> Image:
    """The picture with its hole filled by the mean colour of the known pixels in a ring around the hole.

    image is [h, w, 3], mask [h, w]. Where the mask leaves no known pixel the hole gets mid grey, 0.5.
    """
    ring = ring_around(mask, radius)
    colour = image[ring].mean(0) if ring.any() else np.full(3, 0.5, np.float32)
    return np.where(mask[..., None], colour, image).astype(np.float32)


def mean_colour(photos: list[Photo]) -> NDArray[np.float32]:
    """Mean colour [3] of all known pixels of some photos, each pixel counting alike."""
    total = sum((p.image[p.known].sum(0, dtype=np.float64) for p in photos), np.zeros(3))
    count = sum(int(p.known.sum()) for p in photos)
    return (total / count).astype(np.float32) if count else np.full(3, 0.5, np.float32)


def interpolate_depth(camera: Camera, points: ArrayLike, neighbours: int = 4) -> NDArray[np.float64] | None:
    """Depth along the axis [h, w] from the sparse points [p, 3] that fall in the picture; None if none does.

    Each place takes the mean of its nearest points' inverse depths (a plane is linear in inverse depth), weighted by
    one over the squared pixel distance. Points of surfaces behind are not told apart from those in front. Evaluated at
    every fourth pixel and bilinear between: the points are sparser still, and the cost is a sixteenth.
    """
    xy, z = camera.project(points)
    seen = camera.inside(xy, z)
    if not seen.any():
        return None
    xy, inverse = xy[seen], 1.0 / z[seen]
    k = min(neighbours, len(inverse))
    coarse = camera.resize_to(-(-camera.width // LATTICE), -(-camera.height // LATTICE))
    scale = np.array([camera.width / coarse.width, camera.height / coarse.height])
    rows = []
    for pixels in coarse.pixel_centres() * scale:
        squared = ((pixels[:, None] - xy[None]) ** 2).sum(-1)
        nearest = np.argpartition(squared, k - 1, axis=1)[:, :k]
        # one pixel of slack: a point in the very centre of a pixel must not divide by zero
        weight = 1.0 / (np.take_along_axis(squared, nearest, 1) + 1.0)
        rows.append((weight * inverse[nearest]).sum(1) / weight.sum(1))
    between = sample_bilinear(np.stack(rows)[..., None], camera.pixel_centres() / scale)[..., 0]
    return 1.0 / between.astype(np.float64)


def nearest_photo_warped(camera: Camera, depth: ArrayLike, photos: list[Photo], fallback: ArrayLike) -> Image:
    """The view [h, w, 3] that the photo of the nearest camera gives, warped by a depth map [h, w] of the view.

    A pixel that the nearest photo does not know (outside it, masked) comes from the next nearest; one that
    no photo knows gets the colour `fallback` [3]. Occlusion is not tested: a depth from sparse points is
    too coarse for it.
    """
    out = np.tile(np.asarray(fallback, np.float32), (camera.height, camera.width, 1))
    missing = np.ones((camera.height, camera.width), bool)
    for photo in sorted(photos, key=lambda p: camera_distance(camera, p.camera)):
        if not missing.any():
            break
        known, _ = reproject_mask(photo.known, photo.camera, None, camera, depth)
        taken = missing & known
        warped, _ = warp_image(photo.image, photo.camera, None, camera, depth)
        out[taken] = warped[taken]
        missing &= ~taken
    return out
