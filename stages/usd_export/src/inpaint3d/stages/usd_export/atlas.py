"""A texture for a mesh without a parametrisation: two triangles to a square of texels, colours from the views."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.usd_export.mesh import Mesh
from inpaint3d.stages.usd_export.surface_views import SurfaceView

SMALLEST_SQUARE = 5  # a leg of two texels, and room for the filter around it
LARGEST_SQUARE = 32
GREY = 0.5
BLOCK = 1 << 19  # texels coloured at once; bounds memory


@dataclass(frozen=True)
class Layout:
    """Squares of `square` texels in rows of `per_row`; triangles 2k and 2k + 1 share square k of a `size` texture."""

    size: int
    square: int
    per_row: int

    @property
    def leg(self) -> int:
        """Texels along a leg: three fewer than the square has, so that no bilinear footprint meets the neighbour's."""
        return self.square - 3


def layout(triangles: int, largest: int) -> Layout:
    """The smallest texture (a power of two, at most `largest`) that gives squares of 12 texels, or else the largest.

    Raises ConfigurationError where the squares would be too small to hold a triangle.
    """
    per_row = max(1, int(np.ceil(np.sqrt(np.ceil(triangles / 2)))))
    size = 64
    while size < largest and size // per_row < 12:
        size *= 2
    size = min(size, largest)
    square = min(LARGEST_SQUARE, size // per_row)
    if square < SMALLEST_SQUARE:
        raise ConfigurationError(
            f"{triangles} triangles leave {square} texels a side in a texture of {largest}; lower grid or "
            f"raise texture_size to {SMALLEST_SQUARE * per_row}"
        )
    return Layout(size, square, per_row)


def coordinates(plan: Layout, triangles: int) -> NDArray[np.float32]:
    """Texture coordinates of every triangle's corners, [t, 3, 2]; u to the right, v upwards, as USD has it."""
    k = np.arange(triangles)
    origin = np.stack([(k // 2) % plan.per_row, (k // 2) // plan.per_row], 1) * plan.square
    first = np.array([[0, 0], [plan.leg, 0], [0, plan.leg]]) + 0.5
    texel = np.where((k % 2 == 0)[:, None, None], first, plan.square - first) + origin[:, None]
    return np.stack([texel[..., 0] / plan.size, 1 - texel[..., 1] / plan.size], -1).astype(np.float32)


def bake(
    mesh: Mesh,
    views: Sequence[SurfaceView],
    plan: Layout,
    chosen: NDArray[np.int64],
    weight: NDArray[np.float64],
) -> Image:
    """The texture [size, size, 3]: each triangle's colour is that of its `chosen` views [t, n], blended by `weight`."""
    texture = np.full((plan.size, plan.size, 3), GREY, np.float32)
    texels, inner = _square(plan)
    per_block = max(1, BLOCK // len(texels))
    corners = mesh.corners()
    for start in range(0, len(corners), per_block):
        part = slice(start, start + per_block)
        k = np.arange(len(corners))[part]
        points = np.einsum("pc,tcd->tpd", inner, corners[part])
        colour = _blend(points, views, chosen[part], weight[part])
        origin = np.stack([(k // 2) % plan.per_row, (k // 2) // plan.per_row], 1) * plan.square
        own = np.where((k % 2 == 0)[:, None, None], texels, plan.square - 1 - texels) + origin[:, None]
        texture[own[..., 1], own[..., 0]] = colour
    return texture


def best_views(
    mesh: Mesh, views: Sequence[SurfaceView], count: int, tolerance: float
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each triangle the `count` best views [t, count] and their weights (0: the view does not show it).

    The weight is the triangle's apparent size: the cosine to the viewer over the squared depth, in pixels. A triangle
    may lie `tolerance` (scene units) behind a view's surface and still be the one that the view shows.
    """
    middle, normal = mesh.corners().mean(1), mesh.normals()
    merit = np.zeros((len(middle), len(views)))
    for j, view in enumerate(views):
        xy, z = view.camera.project(middle)
        inside = view.camera.inside(xy, z)
        column, row = np.where(inside[:, None], xy, 0).astype(np.int64).T
        surface = view.depth[row, column]
        # A surface at a slant is deeper at one side of a pixel than at the other: the test widens with depth.
        shown = inside & (surface > 0) & (z - surface < tolerance + 0.02 * z)
        towards = view.camera.centre - middle
        cosine = (normal * towards).sum(1) / np.linalg.norm(towards, axis=1)
        size = view.camera.fx * view.camera.fy / np.square(np.where(inside, z, 1.0))
        merit[:, j] = np.where(shown & (cosine > 0), cosine * size, 0.0)
    count = min(count, len(views))
    chosen = np.argsort(-merit, axis=1, kind="stable")[:, :count]
    return chosen, np.take_along_axis(merit, chosen, 1)


def _blend(
    points: NDArray[np.float64], views: Sequence[SurfaceView], chosen: NDArray[np.int64], weight: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Colours [t, p, 3] of texels at points [t, p, 3], each triangle from its own views; grey where it has none."""
    total = np.zeros(points.shape, np.float64)
    for j, view in enumerate(views):
        triangle, slot = np.nonzero((chosen == j) & (weight > 0))
        if triangle.size:
            xy, z = view.camera.project(points[triangle])
            safe_xy = np.where((z > 0)[..., None], xy, 0.5)
            total[triangle] += weight[triangle, slot][:, None, None] * sample_bilinear(view.rgb, safe_xy)
    mass = weight.sum(1)[:, None, None]
    return np.where(mass > 0, total / np.where(mass > 0, mass, 1.0), GREY).astype(np.float32)


def _square(plan: Layout) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Texels (column, row) of the first triangle in its square [p, 2], and their barycentric coordinates [p, 3].

    Texels just beyond the triangle belong to it too: the bilinear filter reads them. Those on the square's
    diagonal are read by neither triangle, and hold the colour of either.
    """
    column, row = np.meshgrid(np.arange(plan.square), np.arange(plan.square))
    own = column + row <= plan.square - 1
    texels = np.stack([column[own], row[own]], 1)
    u, v = texels.T / plan.leg
    return texels, np.stack([1 - u - v, u, v], 1)
