"""What effects are told by: the sparse points of the longest tracks, and what every view shows where they lie."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.capture_io import SparsePoints, View
from inpaint3d.scene.colour import linear_from_srgb
from inpaint3d.scene.effects.gains import fit_channels
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.reprojection import sample_bilinear

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

DARKEST, BRIGHTEST = 0.03, 0.95  # sRGB; below is noise, above some channel is clipped
MAX_POINTS = 4000
MAX_CELLS = 400_000  # points times views: memory and time of the tables below
FINE, COARSE = (0.8, 1.6), (3.2, 6.4)  # pixels (sigma); below the first is noise, between two of a pair is detail


@dataclass(frozen=True, eq=False)
class Evidence:
    """p points and v views in tables.

    tracked [p, v]: the view was matched there. xy [p, v, 2]: pixels where the point projects to, NaN outside the
    picture; depth [p, v]: z, scene units. residual [p, v, 2]: matched minus projected, pixels; NaN where not tracked.
    colour [p, v, 3]: sRGB there. sharpness [p, v]: log2 of fine over coarse detail there.
    """

    views: Sequence[View]
    ordered: bool
    points: SparsePoints
    xyz: Floats
    tracked: Bools
    xy: Floats
    depth: Floats
    residual: Floats
    colour: Floats
    sharpness: Floats

    @classmethod
    def of(cls, views: Sequence[View], points: SparsePoints, *, ordered: bool) -> "Evidence":
        """Reads every picture once."""
        room = min(MAX_POINTS, MAX_CELLS // max(1, len(views)))
        # The longest tracks say most about gains; ties in the points' own order.
        chosen = np.sort(np.argsort(-np.diff(points.track_offsets), kind="stable")[:room])
        kept = points.select(np.isin(np.arange(len(points)), chosen))
        shape = (len(kept), len(views))
        xyz = kept.xyz.astype(np.float64)
        depth = np.full(shape, np.nan)
        xy, residual = np.full((*shape, 2), np.nan), np.full((*shape, 2), np.nan)
        colour, sharpness = np.full((*shape, 3), np.nan), np.full(shape, np.nan)
        tracked = np.zeros(shape, bool)
        point = kept.track_point
        for index, view in enumerate(views):
            rows = kept.track_frame == index
            mine, matched = point[rows], kept.track_xy[rows].astype(np.float64)
            projected, z = view.camera.project(xyz)
            there = view.camera.inside(projected, z)
            tracked[mine, index] = True
            xy[there, index], depth[there, index] = projected[there], z[there]
            residual[mine, index] = np.where(there[mine, None], matched - projected[mine], np.nan)
            at = np.where(there[:, None], projected, 0.0)
            at[mine] = matched
            looked = there | tracked[:, index]
            image = view.image()
            colour[looked, index] = sample_bilinear(image, at[looked])
            sharpness[looked, index] = _sample_sharpness(image, at[looked])
        return cls(views, ordered, points, xyz, tracked, xy, depth, residual, colour, sharpness)

    @cached_property
    def light(self) -> Floats:
        """log2 of linear light [p, v, 3], EV, where a view was matched and no channel is clipped or black; else NaN."""
        usable = self.tracked & (self.colour.max(-1) < BRIGHTEST) & (self.colour.min(-1) > DARKEST)
        usable &= (usable.sum(1) >= 2)[:, None]
        return np.where(usable[..., None], np.log2(linear_from_srgb(np.clip(self.colour, DARKEST, 1.0))), np.nan)

    @cached_property
    def lit(self) -> NDArray[np.int64]:
        """The points whose colours can be used in two views at least."""
        return np.flatnonzero(np.isfinite(self.light[..., 0]).any(1))

    @cached_property
    def gains(self) -> Floats:
        """What each view's exposure and white balance did to each channel [v, 3], EV."""
        return fit_channels(self.light[self.lit])

    @cached_property
    def even_luma(self) -> Floats:
        """Brightness [points that are lit, v], EV, with the views' gains taken out."""
        return (self.light[self.lit] - self.gains).mean(-1)

    @cached_property
    def directions(self) -> Floats:
        """Unit vectors [p, v, 3] from the points to the cameras."""
        ray = np.stack([view.camera.centre for view in self.views])[None] - self.xyz[:, None]
        return ray / np.linalg.norm(ray, axis=-1, keepdims=True)

    @cached_property
    def neighbours(self) -> NDArray[np.int64]:
        """The two views next to each [v, 2]: before and after in capture order, or the two nearest without one.

        The first and the last of an order have themselves on the side where there is none.
        """
        count = len(self.views)
        if self.ordered:
            return np.clip(np.arange(count)[:, None] + (-1, 1), 0, count - 1)
        centres = np.stack([view.camera.centre for view in self.views])
        apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
        return np.argsort(apart, axis=1, kind="stable")[:, [min(1, count - 1), min(2, count - 1)]]

    @cached_property
    def expected(self) -> Bools:
        """Where a point should be seen [p, v]: within the picture, and matched in the views on both sides."""
        both = self.tracked[:, self.neighbours[:, 0]] & self.tracked[:, self.neighbours[:, 1]]
        return np.isfinite(self.xy[..., 0]) & (self.tracked | both)


def _sample_sharpness(image: Image, xy: Floats) -> Floats:
    """log2 of fine over coarse detail at pixels [n, 2]: the finest detail is what a blur takes away first."""
    grey = np.asarray(image, np.float32).mean(-1)
    fine, coarse = (cv2.GaussianBlur(grey, (0, 0), a) - cv2.GaussianBlur(grey, (0, 0), b) for a, b in (FINE, COARSE))
    bands = np.stack([fine**2, coarse**2, 0 * grey], -1)
    energy = sample_bilinear(cv2.GaussianBlur(bands, (0, 0), 3.0), xy).astype(np.float64)
    # A floor of a quarter of a grey level of 8 bits: without detail there is nothing to tell.
    return 0.5 * np.log2((energy[:, 0] + 1e-6) / (energy[:, 1] + 1e-6))
