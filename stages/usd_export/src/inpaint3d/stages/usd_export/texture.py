"""The colours of a mesh from pictures: fine detail from the best one, everything broader blended from all.

Two bands (Burt and Adelson 1983, doi:10.1145/245.247, as Allene et al. 2008, doi:10.1109/ICPR.2008.4761913, use them):
what differs between pictures in exposure is broad and is evened out by blending, what would be blurred by blending is
fine and is taken from one, so that neither seams nor blur remain.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.stages.usd_export.atlas import Texels
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.rays import Caster

Floats = NDArray[np.float32]

BROAD = 3.0  # pixels; standard deviation of the filter that parts broad from fine
FEATHER = 8.0  # pixels from an edge over which a picture gains its full say
SAME_SURFACE = 0.02  # share of its depth by which a point may miss the surface that a picture shows
DEPTH_STEP = 0.04  # share of its depth by which a pixel may miss the plane through its neighbours; more is an edge
AGREEMENT = 0.08  # sRGB; pictures farther than this from the others show something else
ROUNDS = 2
GAIN_TEXELS = 20_000
GAIN_ROUNDS = 20
BLOCK = 1 << 14  # texels coloured at once; bounds memory


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture [h, w, 3] with its camera, and which of its pixels may be used, bool [h, w].

    masked: which pixels lie under the mask [h, w], used or not.
    """

    camera: Camera
    image: Image
    usable: Mask
    masked: Mask | None = None

    @cached_property
    def broad(self) -> Image:
        """The picture without fine detail; unusable pixels have no part in it."""
        weight = cv2.GaussianBlur(self.usable.astype(np.float32), (0, 0), BROAD)
        summed = cv2.GaussianBlur(self.image * self.usable[..., None], (0, 0), BROAD)
        return (summed / np.maximum(weight, 1e-6)[..., None]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Sight:
    """What a picture shows of a mesh: depth along the axis [h, w] (0: nothing), which triangles [t], and its say [h, w]
    in [0, 1]: none where it may not be used or where surfaces end, more towards the middle of what it shows.

    masked: which triangles [t] lie under the mask in at least half of their pixels.
    """

    picture: Picture
    depth: Floats
    triangles: NDArray[np.bool_]
    say: Floats
    masked: NDArray[np.bool_]


def look(mesh: Mesh, caster: Caster, picture: Picture) -> Sight:
    """Cast a ray through every pixel of the picture at the mesh."""
    camera = picture.camera
    hits = caster.look(camera)
    z = hits.distance * (camera.rays()[1].reshape(-1, 3) @ camera.forward)
    met = hits.triangle >= 0
    depth = np.where(met, z, 0.0).astype(np.float32).reshape(camera.height, camera.width)
    count = len(mesh.triangles)
    pixels = np.bincount(hits.triangle[met], minlength=count)
    under = np.zeros_like(met) if picture.masked is None else picture.masked.ravel()
    masked = np.bincount(hits.triangle[met & under], minlength=count)
    sound = picture.usable & ~_find_edges(depth)
    sound[[0, -1]] = sound[:, [0, -1]] = False
    inward = cv2.distanceTransform(sound.astype(np.uint8), cv2.DIST_L2, 5)
    return Sight(picture, depth, pixels > 0, np.minimum(inward / FEATHER, 1.0), (pixels > 0) & (2 * masked >= pixels))


def _find_edges(depth: Floats) -> Mask:
    """Where surfaces end in a depth map [h, w], and where there is none (0).

    Along a line of pixels the inverse depth of a plane is straight, however steeply it is seen.
    """
    inverse = 1 / np.where(depth > 0, depth, np.inf)
    across = np.array([[1, -2, 1]], np.float32)
    bend = np.maximum(
        *(np.abs(cv2.filter2D(inverse, -1, k, borderType=cv2.BORDER_REPLICATE)) for k in (across, across.T))
    )
    return (depth <= 0) | (bend > DEPTH_STEP * inverse)


def even_exposures(mesh: Mesh, texels: Texels, sights: Sequence[Sight]) -> list[Sight]:
    """The sights with a gain on each channel of each picture, so that pictures agree about what several show.

    Gains and the surface's colours are found in turn by least squares, on some of the texels; their mean is 1.
    """
    few = slice(None, None, max(1, len(texels.row) // GAIN_TEXELS))
    triangle = texels.triangle[few]
    points = np.einsum("nc,ncd->nd", texels.barycentric[few], mesh.corners()[triangle])
    weight, broad, _ = _gather(points, mesh.normals()[triangle], triangle, sights)
    weight *= (weight > 0).sum(0) > 1
    gains = np.ones((len(sights), 1, 3))
    for _ in range(GAIN_ROUNDS):
        mean = (weight[..., None] * broad * gains).sum(0) / np.maximum(weight.sum(0), 1e-12)[:, None]
        own, common = (weight[..., None] * np.square(broad)).sum(1), (weight[..., None] * broad * mean).sum(1)
        gains = np.where(own > 0, common / np.where(own > 0, own, 1.0), 1.0)[:, None]
        gains /= gains.mean(0)
    return [
        replace(sight, picture=replace(sight.picture, image=(sight.picture.image * gain).astype(np.float32)))
        for sight, gain in zip(sights, gains, strict=True)
    ]


def paint(mesh: Mesh, texels: Texels, sights: Sequence[Sight]) -> tuple[Floats, NDArray[np.bool_]]:
    """Colours [n, 3] of the texels, and which of them any picture shows [n]; 0 where none does."""
    colour, known = np.zeros((len(texels.row), 3), np.float32), np.zeros(len(texels.row), bool)
    corners, normals = mesh.corners(), mesh.normals()
    # Neighbours on the mesh are seen by the same few pictures; neighbours in the texture are not.
    order = np.argsort(texels.triangle, kind="stable")
    for start in range(0, len(known), BLOCK):
        part = order[start : start + BLOCK]
        triangle = texels.triangle[part]
        points = np.einsum("nc,ncd->nd", texels.barycentric[part], corners[triangle])
        own = [sight for sight in sights if sight.triangles[triangle].any()]
        if own:
            colour[part], known[part] = _blend(points, normals[triangle], triangle, own)
    return colour, known


def measure_filled(sights: Sequence[Sight]) -> Floats:
    """Of the pictures that show a triangle, the share in which it lies under the mask, [t]; 0 where none shows it."""
    shown, masked = (np.sum([getattr(s, name) for s in sights], 0) for name in ("triangles", "masked"))
    return (masked / np.maximum(shown, 1)).astype(np.float32)


def fill_texture(texels: Texels, colour: Floats, known: NDArray[np.bool_], size: int) -> Image:
    """The texture [size, size, 3]: texels that nothing shows, and those between charts, are as the nearest known."""
    texture, empty = np.full((size, size, 3), 0.5, np.float32), np.ones((size, size), bool)
    row, column = texels.row[known], texels.column[known]
    texture[row, column], empty[row, column] = colour[known], False
    nearest = np.asarray(distance_transform_edt(empty, return_distances=False, return_indices=True))
    return texture[nearest[0], nearest[1]]


def _gather(
    points: NDArray[np.float64], normals: NDArray[np.float64], triangle: NDArray[np.int64], sights: Sequence[Sight]
) -> tuple[Floats, Floats, Floats]:
    """Of every sight the weights [s, n] of points, and their broad and whole colours [s, n, 3]."""
    shape = (len(sights), len(points))
    weight, broad, whole = np.zeros(shape, np.float32), *(np.zeros((*shape, 3), np.float32) for _ in range(2))
    for i, sight in enumerate(sights):
        own = np.flatnonzero(sight.triangles[triangle])
        if own.size:
            weight[i, own], broad[i, own], whole[i, own] = _sample(sight, points[own], normals[own])
    return weight, broad, whole


def _blend(
    points: NDArray[np.float64], normals: NDArray[np.float64], triangle: NDArray[np.int64], sights: Sequence[Sight]
) -> tuple[Floats, NDArray[np.bool_]]:
    weight, broad, whole = _gather(points, normals, triangle, sights)
    agreed = weight
    for _ in range(ROUNDS):
        mean = np.einsum("vn,vnc->nc", agreed, broad) / np.maximum(agreed.sum(0), 1e-30)[:, None]
        away = broad - mean
        apart = np.einsum("vnc,vnc->vn", away, away)
        agreed = weight * np.exp(-np.minimum(apart / (2 * AGREEMENT**2), 30.0))
    mean = np.einsum("vn,vnc->nc", agreed, broad) / np.maximum(agreed.sum(0), 1e-30)[:, None]
    best, column = np.argmax(agreed, 0), np.arange(len(points))
    return (mean + whole[best, column] - broad[best, column]).clip(0, 1), weight.sum(0) > 0


def _sample(sight: Sight, points: NDArray[np.float64], normals: NDArray[np.float64]) -> tuple[Floats, Floats, Floats]:
    """Weights [n] of points in a picture, its broad and its whole colours there, [n, 3] each.

    The weight is the point's apparent size, the cosine to the viewer over the squared depth in pixels, squared so that
    near and straight views count most.
    """
    camera = sight.picture.camera
    xy, z = camera.project(points)
    inside = camera.inside(xy, z)
    safe_z = np.where(inside, z, 1.0)
    at = (np.where(inside[:, None], xy, 0.5) - 0.5).astype(np.float32)
    depth, say = (_look_up(m, at) for m in (sight.depth, sight.say))
    towards = camera.centre - points
    cosine = np.einsum("nc,nc->n", normals, towards) / np.sqrt(np.einsum("nc,nc->n", towards, towards))
    shown = inside & (np.abs(depth - z) < SAME_SURFACE * safe_z) & (cosine > 0)
    size = np.maximum(cosine, 0) * camera.fx * camera.fy / np.square(safe_z)
    weight = np.where(shown, say * np.square(size), 0.0).astype(np.float32)
    return weight, _look_up(sight.picture.broad, at), _look_up(sight.picture.image, at)


def _look_up(values: NDArray[np.float32], at: Floats) -> Floats:
    """Bilinear values [n, ...] of a map at pixel positions [n, 2], counted from the centre of pixel (0, 0)."""
    # OpenCV's maps are smaller than 32768 a side.
    rows = -(-len(at) // 1024)
    grid = np.zeros((rows * 1024, 2), np.float32)
    grid[: len(at)] = at
    x, y = (np.ascontiguousarray(axis).reshape(rows, 1024) for axis in grid.T)
    found = cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(found, np.float32).reshape(rows * 1024, *values.shape[2:])[: len(at)]
