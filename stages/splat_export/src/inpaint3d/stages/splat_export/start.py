"""Splats to begin with: one for each patch of surface that the views show, as big as the patch, lying in it."""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.radiance.surface_views import SurfaceView
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.normals import normals_of
from inpaint3d.stages.splat_export.cloud import SplatCloud

OPAQUE = 2.0  # logit of the opacity
SPREAD = 0.45  # standard deviation along the surface, in the distance to the next splat
THICKNESS = 0.25  # across it, in that along it
FINEST = 0.7  # cells to thin out by at first, in a pixel's footprint

Floats = NDArray[np.float64]


class Samples(NamedTuple):
    """Places [n, 3] on surfaces with the unit normal (0: unknown) and the colour there, and how wide a pixel is [n]."""

    place: Floats
    normal: Floats
    rgb: Floats
    width: Floats


def begin(views: Sequence[SurfaceView], pictures: Sequence[Image], most: int) -> SplatCloud:
    """At most `most` (>= 8) splats on what the views' depth shows, in the colours of their pictures, of any size.

    Where several views show a place, the one that shows it largest has it.
    """
    parts = [sample_view(view, picture) for view, picture in zip(views, pictures, strict=True)]
    every = Samples(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
    finest_first = np.argsort(every.width, kind="stable")
    every = Samples(*(column[finest_first] for column in every))
    cells = FINEST
    while np.count_nonzero(kept := thin_out(every.place, every.width * cells)) > most:
        cells *= max(1.05, (np.count_nonzero(kept) / most) ** 0.5)
    place, normal, rgb, width = (column[kept] for column in every)
    along = np.log(SPREAD * cells * width)
    log_scale = np.stack([along, along, along + np.log(THICKNESS)], 1)
    parts = (place, log_scale, lie_across(normal), np.full(len(place), OPAQUE), rgb)
    return SplatCloud(*(np.ascontiguousarray(part, np.float32) for part in parts))


def sample_view(view: SurfaceView, picture: Image) -> Samples:
    """One for each pixel of the depth [h, w] that is above 0."""
    height, width = view.depth.shape
    small = cv2.resize(np.ascontiguousarray(picture, np.float32), (width, height), interpolation=cv2.INTER_AREA)
    shown = view.depth > 0
    z = view.depth[shown].astype(np.float64)
    place = view.camera.unproject(view.camera.pixel_centres()[shown], z)
    normal = normals_of(view.camera, np.where(shown, view.depth, np.nan))[shown]
    return Samples(place, normal.astype(np.float64), small[shown].astype(np.float64), z / view.camera.fx)


def thin_out(place: Floats, size: Floats) -> NDArray[np.bool_]:
    """Which of places [n, 3] are the first in their cell [n]; sizes ascend, and are taken as powers of two.

    A coarse cell that holds a place of a finer one is taken already.
    """
    level = np.floor(np.log2(size)).astype(np.int64)
    kept = np.zeros(len(place), bool)
    for one in np.unique(level):
        here = np.flatnonzero(level == one)
        code = _number_cells(place[here], one)
        code, first = np.unique(code, return_index=True)
        taken = np.isin(code, _number_cells(place[kept], one))
        kept[here[first[~taken]]] = True
    return kept


def _number_cells(place: Floats, level: int) -> NDArray[np.int64]:
    """A number for the cell of side 2^level that each place lies in; 2^20 cells to either side of the origin."""
    cell = np.floor(place / 2.0**level).astype(np.int64).clip(-(1 << 20), (1 << 20) - 1) + (1 << 20)
    return (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]


def lie_across(normal: Floats) -> Floats:
    """Quaternions w, x, y, z [n, 4] of unit length that turn the z axis to unit normals [n, 3]; none for 0."""
    half = np.stack([1 + normal[:, 2], -normal[:, 1], normal[:, 0], np.zeros(len(normal))], 1)
    length = np.linalg.norm(half, axis=1, keepdims=True)
    # Straight down there is no shortest turn: any half turn about an axis across does.
    return np.where(length > 1e-6, half / np.maximum(length, 1e-6), (0.0, 1.0, 0.0, 0.0))
