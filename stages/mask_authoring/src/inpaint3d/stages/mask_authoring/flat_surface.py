"""A plane of the scene seen from straight above by all views at once: its colours, and what stands on it."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.colour import linear_from_srgb
from inpaint3d.scene.planes import Plane
from inpaint3d.scene.selection import choose_evenly
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

LOOKED_AT = 48  # views that tell a surface's colours
CARVED_BY = 16  # views that carve the hull
WITNESSES = 3  # views that must see a place, at least
IN_FRONT = 0.02  # of the depth: what lies so far before the plane hides it; the field's depth is off by half of that
ON_PLANE = 0.01  # of the depth: how far the median of the views' depths may lie off the plane
INSIDE = 0.9  # share of the views that have a place masked from which on it is the hull's
DARKEST = 1e-3  # linear light under which brightness is noise


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """Square cells on a plane: origin [3] is the grid's middle, axes [2, 3] unit vectors along rows and down columns,
    up [3] the plane's normal on the cameras' side; cell: side of a cell, scene units; side: cells of rows and columns.
    """

    plane: Plane
    origin: Floats
    axes: Floats
    up: Floats
    cell: float
    side: int

    @classmethod
    def around(cls, plane: Plane, middle: Floats, reach: float, cameras: Sequence[Camera], side: int) -> "PlaneGrid":
        """The grid around the foot of a point [3] that reaches so far (scene units) to every side."""
        above = np.median([c.centre @ plane.normal - plane.offset for c in cameras]) > 0
        up = plane.normal if above else -plane.normal
        first = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
        first /= np.linalg.norm(first)
        foot = middle - (middle @ plane.normal - plane.offset) * plane.normal
        axes = np.stack([first, np.cross(up, first)]).astype(np.float64)
        return cls(plane, foot, axes, up, 2 * reach / side, side)

    def points(self, height: float = 0.0) -> Floats:
        """The cells' middles, lifted off the plane by a height in scene units, [side, side, 3]."""
        along = (np.arange(self.side) + 0.5 - self.side / 2) * self.cell
        flat = along[None, :, None] * self.axes[0] + along[:, None, None] * self.axes[1]
        return self.origin + height * self.up + flat

    def look_up(self, values: Floats, points: Floats) -> Floats:
        """Values [side, side] of the cells, bilinear, under points [*n, 3]; 0 beyond the grid."""
        at = ((points - self.origin) @ self.axes.T / self.cell + self.side / 2 - 0.5).astype(np.float32)
        return _sample(values, at)


@dataclass(frozen=True, eq=False)
class Texture:
    """Log of linear light [side, side, 3] of a surface, 0 where not `known` [side, side]."""

    log_colour: Floats
    known: Bools


def see_surface(grid: PlaneGrid, views: Sequence[DepthView], masks: Sequence[Bools]) -> Texture:
    """What the views show of a plane outside their masks: the median of their colours, so that highlights drop out.

    A place is on the surface where the median of the views' depths says so: a table's plane goes on beyond the table.
    """
    points, colours, apart = grid.points(), [], []
    for view, mask in choose_evenly(list(zip(views, masks, strict=True)), LOOKED_AT):
        xy, z = view.camera.project(points.reshape(-1, 3))
        inside = view.camera.inside(xy, z)
        xy[~inside] = 0.5
        free = inside & ~mask[xy[:, 1].astype(np.int64), xy[:, 0].astype(np.int64)]
        off = np.where(free, view.depth_at(xy) / np.where(free, z, 1.0) - 1, np.nan)
        off[np.isinf(off)] = np.nan
        pixels = max(1.0, grid.cell * view.camera.fx / float(np.median(z[inside]))) if inside.any() else 1.0
        picture = cv2.GaussianBlur(linear_from_srgb(view.image()), (0, 0), pixels / 2)
        seen = _sample(picture, (xy - 0.5).astype(np.float32).reshape(grid.side, grid.side, 2))
        clear = (free & ~(off < -IN_FRONT)).reshape(grid.side, grid.side, 1)
        colours.append(np.where(clear, np.log(np.maximum(seen, DARKEST)), np.nan))
        apart.append(off.reshape(grid.side, grid.side))
    seen_by = np.isfinite(colours).all(-1).sum(0)
    flat = np.abs(_median(np.array(apart))) < ON_PLANE
    known = (seen_by >= min(WITNESSES, len(views))) & flat
    return Texture(np.where(known[..., None], _median(_even_gains(np.array(colours))), 0.0), known)


def slice_hull(grid: PlaneGrid, views: Sequence[DepthView], masks: Sequence[Bools], step: float) -> list[Bools]:
    """The masks' visual hull (Laurentini, PAMI 1994), cut parallel to a plane every `step` cells, from the plane up.

    Ends where the hull does; empty where it does not reach the plane.
    """
    chosen = choose_evenly(list(zip(views, masks, strict=True)), CARVED_BY)
    slices: list[Bools] = []
    while len(slices) * step < grid.side:
        points = grid.points(len(slices) * step * grid.cell).reshape(-1, 3)
        inside, seen = np.zeros(len(points)), np.zeros(len(points))
        for view, mask in chosen:
            xy, z = view.camera.project(points)
            here = view.camera.inside(xy, z)
            x, y = np.where(here[:, None], xy, 0).astype(np.int64).T
            inside += here & mask[y, x]
            seen += here
        held = (seen >= min(WITNESSES, len(views))) & (inside >= INSIDE * seen)
        if not held.any():
            break
        slices.append(held.reshape(grid.side, grid.side))
    return slices


def _sample(picture: NDArray[np.generic], at: NDArray[np.float32]) -> Floats:
    """A picture [h, w, ...] at (column, row) of pixels' middles [n, m, 2], bilinear; 0 beyond its border."""
    columns, rows = at[..., 0], at[..., 1]
    found = cv2.remap(picture.astype(np.float32), columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    return np.asarray(found, np.float64)


def _even_gains(colours: Floats) -> Floats:
    """Log colours [n, side, side, 3], nan where not seen, less what each whole picture is brighter than the median."""
    middle = _median(colours)
    gains = np.array([_median((one - middle).reshape(-1, 3)) for one in colours])
    return colours - gains[:, None, None]


def _median(values: Floats) -> Floats:
    """Over the first axis, of the values that are numbers; nan where there is none."""
    ordered = np.sort(values, 0)
    count = np.isfinite(values).sum(0)
    low, high = (np.take_along_axis(ordered, i[None].clip(0), 0)[0] for i in ((count - 1) // 2, count // 2))
    return np.where(count > 0, (low + high) / 2, np.nan)
