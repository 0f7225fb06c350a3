"""Before anything is invented: which masked pixels show a surface that other views know, and need no prior."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.map_io import read_exr
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.morphology import grow

TOLERANCE = 1.5
"""Cells by which a surface point may miss the pixel it came from, seen there and back through another view's depth.

Both views' depth errors count as far as they show: far away, where little parallax is left, depths may differ a lot.
"""

SAME_SURFACE = 0.1
"""Share by which the disparities of neighbouring cells of one surface differ at most."""

Cell = TypeVar("Cell", bound=np.generic)


@dataclass(frozen=True, eq=False)
class CoarseView:
    """A view at the size of its depth map: camera, depth along the axis, and what the mask leaves of each cell."""

    camera: Camera
    depth: NDArray[np.float32]
    hole: Mask  # any pixel of the cell is masked
    known: Mask  # every pixel of the cell is known


def load_depth_maps(
    views: Sequence[MaskedView], field: Artifact[RadianceFieldArtifact]
) -> dict[str, NDArray[np.float32]]:
    """By view, where the light of a fitted field stops (median depth z, scene units), as its artifact has it.

    Raises BadInputError where the field has no render of a view.
    """
    maps = {v.name: read_exr(field.path(v.maps))["median.Z"] for v in field.metadata.views}
    if missing := [v.name for v in views if v.name not in maps]:
        raise BadInputError(f"the field has no render of view {missing[0]}; it belongs to another capture")
    return maps


def shrink_holes(
    views: Sequence[MaskedView], depths: Mapping[str, NDArray[np.float32]], min_supporting_views: int
) -> list[MaskedView]:
    """The views with their holes reduced to what fewer than `min_supporting_views` other views know.

    depths: by view, a depth map (scene units along the axis, any size) of a field that was fitted to known pixels
    alone. A masked pixel is known elsewhere if the surface point behind it projects onto known pixels of other views,
    and what they see there projects back onto it. What a hole loses is neither hole nor known: nothing is distilled
    there, and the photo's pixels stay blank.
    """
    coarse = [coarsen(v, depths[v.name]) for v in views]
    reduced = []
    for index, (view, own) in enumerate(zip(views, coarse, strict=True)):
        support = np.zeros(own.hole.shape, np.int64)
        y, x = np.nonzero(own.hole)
        pixels = np.stack([x + 0.5, y + 0.5], -1)
        points = own.camera.unproject(pixels, own.depth[y, x])
        for other in (*coarse[:index], *coarse[index + 1 :]):
            support[y, x] += find_visible(other, points, own.camera, pixels)
        # One cell more is filled anew, so that the seam between known and filled pixels can be blended.
        unseen = grow(own.hole & (support < min_supporting_views), 1)
        reduced.append(replace(view, hole=view.hole & enlarge_cells(unseen, view.hole.shape)))
    return reduced


def find_visible(view: CoarseView, points: NDArray[np.float64], own: Camera, pixels: NDArray[np.floating]) -> Mask:
    """Which points [n, 3], seen by `own` at `pixels` [n, 2], lie on a surface that the view shows outside its mask."""
    xy, z = view.camera.project(points)
    inside = view.camera.inside(xy, z)
    x, y = (np.where(inside, xy[:, axis], 0).astype(np.int64) for axis in (0, 1))
    back, depth = own.project(view.camera.unproject(xy, view.depth[y, x]))
    missed = np.linalg.norm(back - pixels, axis=-1)
    return inside & view.known[y, x] & (depth > 0) & (missed < TOLERANCE)


def coarsen(view: MaskedView, depth: NDArray[np.float32]) -> CoarseView:
    """The view at the size of its depth map [h, w]."""
    h, w = depth.shape
    return CoarseView(view.camera.resize_to(w, h), depth, pool_any(view.hole, h, w), ~pool_any(~view.known, h, w))


def pool_any(mask: Mask, height: int, width: int) -> Mask:
    """Whether any pixel of each cell is set; `mask` [h, w] is at least as large as (height, width)."""
    rows = np.linspace(0, mask.shape[0], height + 1)[:-1].astype(np.int64)
    columns = np.linspace(0, mask.shape[1], width + 1)[:-1].astype(np.int64)
    return np.logical_or.reduceat(np.logical_or.reduceat(mask, rows, axis=0), columns, axis=1)


def enlarge_cells(cells: NDArray[Cell], shape: tuple[int, ...]) -> NDArray[Cell]:
    """The nearest of `cells` [h, w] for each pixel of a picture of `shape` (h, w)."""
    y = (np.arange(shape[0]) + 0.5) * cells.shape[0] / shape[0]
    x = (np.arange(shape[1]) + 0.5) * cells.shape[1] / shape[1]
    return cells[y.astype(np.int64)[:, None], x.astype(np.int64)[None]]


def enlarge_depth(depth: NDArray[np.floating], shape: tuple[int, int]) -> NDArray[np.float64]:
    """A depth map z [h, w] > 0 at a larger `shape`: linear in disparity, as planes are, with edges where surfaces end.

    Of the four cells around a pixel those count that lie on one surface, the one of most weight: between two surfaces
    there is nothing.
    """
    disparity = 1 / depth.astype(np.float64)
    (low_y, share_y), (low_x, share_x) = (_find_cells(n, m) for n, m in zip(shape, depth.shape, strict=True))
    corners, weights = [], []
    for dy, dx in ((0, 0), (0, 1), (1, 0), (1, 1)):
        rows, columns = (
            np.minimum(low + d, n - 1) for low, d, n in ((low_y, dy, len(depth)), (low_x, dx, len(depth[0])))
        )
        corners.append(disparity[rows[:, None], columns])
        weights.append(np.abs(1 - dy - share_y)[:, None] * np.abs(1 - dx - share_x))
    most, made = np.zeros(shape), np.empty(shape)
    for own in corners:
        alike = [w * (np.abs(other - own) < SAME_SURFACE * own) for w, other in zip(weights, corners, strict=True)]
        weight = np.sum(alike, 0)
        # The four sums of one surface may differ in their last digit.
        better = weight > most + 1e-9
        mean = np.sum([a * other for a, other in zip(alike, corners, strict=True)], 0) / np.maximum(weight, 1e-9)
        most, made = np.where(better, weight, most), np.where(better, mean, made)
    return 1 / made


def _find_cells(pixels: int, cells: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """For each pixel centre of a line the cell whose centre lies before it, and how far on to the next one it is."""
    at = ((np.arange(pixels) + 0.5) * cells / pixels - 0.5).clip(0, cells - 1)
    low = np.minimum(at.astype(np.int64), max(0, cells - 2))
    return low, at - low
