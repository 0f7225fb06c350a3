"""How a hole is filled, decided on cells of a few pixels: depths, whose colours go where, and what evens them out."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.membrane import NEIGHBOURS, span_membrane
from inpaint3d.scene.morphology import grow
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.plate_export.lens import Box, Floats
from inpaint3d.stages.plate_export.photo_files import Colours
from inpaint3d.stages.plate_export.photos import Photos
from inpaint3d.stages.plate_export.pieces import Offer, Piece
from inpaint3d.stages.plate_export.views import PlateView

RING = 12
"""Cells around the hole in which depths and colours are compared."""
SEAM = 3
"""Cells on either side of a seam over which its step is averaged: grain is no step."""
MAX_STEP = 0.15
"""A step, of full range, from which on two sides of a seam are two things, and are not joined."""
MAX_PHOTOS = 8
"""Photos that a hole is filled from, where these show what it needs."""
MIN_SHARE = 0.01
"""Share of what photos show below which another photo is not worth its seams."""
SAMPLES = 3000
"""Cells by which photos are ranked."""
TURN = 0.2
"""Angle, radians, between two lines of sight by which a photo counts less by a factor e."""
FEATHER = 1.2
"""Cells over which pieces fade into each other (standard deviation)."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Cells of a box of the photo around its hole: rays [h, w, 2], hole and known [h, w], codes of sources [h, w]."""

    box: Box
    cell: int
    rays: Floats
    hole: Mask
    known: Mask
    codes: NDArray[np.uint16]

    def places(self, box: Box, mask: Mask) -> Floats:
        """Where the middles of the pixels of `box` under `mask` are among the cells [n, 2]."""
        y, x = np.nonzero(mask)
        xy = np.stack([x + box.x0 + 0.5, y + box.y0 + 0.5], -1)
        return (xy - (self.box.x0, self.box.y0)) / self.cell


@dataclass(frozen=True, eq=False)
class Plan:
    """disparity [h, w]; labels [h, w]: number of the piece, -1 outside the hole; weights [h, w] and corrections
    [h, w, c] of each piece.
    """

    grid: Grid
    disparity: Floats
    pieces: list[Piece]
    labels: NDArray[np.int64]
    weights: list[NDArray[np.float32]]
    corrections: list[Colours]


def find_box(view: PlateView, margin: int) -> Box | None:
    """The box of the photo that holds its hole and `margin` pixels around it; None where it has none."""
    width, height = view.camera.lens.width, view.camera.lens.height
    coarse = max(1, min(width, height) // 256)
    y, x = np.nonzero(grow(view.covers(view.camera.rays(Box(0, 0, width, height), coarse)), 1))
    if len(x) == 0:
        return None
    return Box(
        max(0, int(x.min()) * coarse - margin),
        max(0, int(y.min()) * coarse - margin),
        min(width, (int(x.max()) + 1) * coarse + margin),
        min(height, (int(y.max()) + 1) * coarse + margin),
    )


def make_grid(view: PlateView, box: Box, cell: int) -> Grid:
    """The cells of a box, with what the posed view has there."""
    rays = view.camera.rays(box, cell)
    posed = view.camera.to_posed(rays)
    h, w = view.hole.shape
    x, y = posed[..., 0].astype(np.int64).clip(0, w - 1), posed[..., 1].astype(np.int64).clip(0, h - 1)
    hole = view.covers(rays)
    codes = view.sources[y, x]
    # The hole's rim, between the posed view's pixels, is filled as the hole beside it is.
    if (missing := hole & (codes == 0)).any() and (codes > 0).any():
        nearest = ndimage.distance_transform_edt(codes == 0, return_distances=False, return_indices=True)
        codes = np.where(missing, codes[tuple(np.asarray(nearest))], codes)
    return Grid(box, cell, rays, hole, view.knows(rays) & ~hole, np.where(hole, codes, 0).astype(np.uint16))


def assign_pieces(grid: Grid, disparity: Floats, offered: Sequence[Offer]) -> NDArray[np.int64]:
    """For each cell of the hole the number of the piece that fills it; -1 elsewhere.

    What photos show is taken from few of them, since every seam costs; the rest from the first piece that may and can.
    """
    labels = np.full(grid.hole.shape, -1)
    shown = grid.hole & (grid.codes >= FIRST_PHOTO)
    for number in rank_photos(grid, disparity, offered, shown):
        if (seen := offered[number].seen) is not None:
            _take(labels, number, shown & (labels < 0), grid, disparity, seen)
    for number, offer in enumerate(offered):
        may = np.isin(grid.codes, offer.codes) | (number == len(offered) - 1)
        _take(labels, number, grid.hole & (labels < 0) & may, grid, disparity, offer.piece)
    return labels


def rank_photos(grid: Grid, disparity: Floats, offered: Sequence[Offer], shown: Mask) -> list[int]:
    """Numbers of the few photos that between them show what is `shown` [h, w], each chosen for what is left, by how
    much of it it shows and how nearly from the plate's side.
    """
    y, x = np.nonzero(shown)
    step = max(1, len(y) // SAMPLES)
    rays, near = grid.rays[y[::step], x[::step]], disparity[y[::step], x[::step]]
    worth: dict[int, NDArray[np.float64]] = {}
    for number, offer in enumerate(offered):
        if offer.seen is not None and len(rays):
            usable = offer.seen.find_usable(rays, near)
            worth[number] = np.where(usable, np.exp(-offer.seen.measure_turn(rays, near) / TURN), 0)
    chosen: list[int] = []
    left = np.ones(len(rays), bool)
    while len(chosen) < MAX_PHOTOS and worth:
        best = max(worth, key=lambda number: float(worth[number][left].sum()))
        if ((worth[best] > 0) & left).sum() <= MIN_SHARE * len(rays):
            break
        chosen.append(best)
        left &= worth.pop(best) == 0
    return chosen


def _take(labels: NDArray[np.int64], number: int, asked: Mask, grid: Grid, disparity: Floats, piece: Piece) -> None:
    """Give `number` to the cells of `asked` [h, w] for which the piece has colours."""
    if asked.any():
        usable = piece.find_usable(grid.rays[asked], disparity[asked])
        y, x = np.nonzero(asked)
        labels[y[usable], x[usable]] = number


def make_plan(
    view: PlateView, photos: Photos, grid: Grid, disparity: Floats, pieces: list[Piece], labels: NDArray[np.int64]
) -> Plan:
    """Weights and corrections of the pieces that have cells; the others are dropped."""
    used = np.unique(labels[labels >= 0])
    renamed = np.full(labels.max(initial=-1) + 2, -1)
    renamed[used] = np.arange(len(used))
    labels, pieces = np.where(labels >= 0, renamed[labels], -1), [pieces[i] for i in used]
    own = sample_own(view, photos, grid)
    colours, valid = zip(*(_sample_around(grid, disparity, p, labels == i) for i, p in enumerate(pieces)), strict=True)
    corrections = even_out(grid, own, labels, colours, valid)
    weights = [_feather(labels == i, valid[i] & grid.hole) for i in range(len(pieces))]
    return Plan(grid, disparity, pieces, labels, weights, corrections)


def sample_own(view: PlateView, photos: Photos, grid: Grid) -> Colours:
    """The photo's own colours of the cells [h, w, c]."""
    y, x = np.meshgrid(
        grid.box.y0 + (np.arange(grid.hole.shape[0]) + 0.5) * grid.cell,
        grid.box.x0 + (np.arange(grid.hole.shape[1]) + 0.5) * grid.cell,
        indexing="ij",
    )
    made = photos.sample(view.name, np.stack([x, y], -1).reshape(-1, 2), grid.cell)
    return made.reshape(*grid.hole.shape, -1)


def _sample_around(grid: Grid, disparity: Floats, piece: Piece, part: Mask) -> tuple[Colours, Mask]:
    """A piece's colours [h, w, c] over its part and the cells beside it, and where it has any."""
    around = grow(part, SEAM) & (grid.hole | grid.known)
    sampled, usable = piece.sample(grid.rays[around], disparity[around], grid.cell)
    colours = np.zeros((*part.shape, sampled.shape[-1]), np.float32)
    colours[around] = sampled
    valid = np.zeros_like(part)
    valid[around] = usable
    return colours, valid


def _feather(part: Mask, valid: Mask) -> NDArray[np.float32]:
    blurred = cv2.GaussianBlur(part.astype(np.float32), (0, 0), FEATHER)
    return np.where(part, np.maximum(blurred, 0.05), np.where(valid, blurred, 0)).astype(np.float32)


def even_out(
    grid: Grid,
    own: Colours,
    labels: NDArray[np.int64],
    colours: Sequence[Colours],
    valid: Sequence[Mask],
) -> list[Colours]:
    """What to add to each piece [h, w, c], so that nothing steps at a seam and every piece keeps its gradients.

    Poisson image editing (Perez, Gangnet and Blake 2003, doi:10.1145/882262.882269) of all pieces at once, solved for
    the change instead of the colours: it is harmonic within a piece, is at the hole's edge what the piece misses of
    the photo there, and steps between two pieces by what one misses of the other. At an edge beyond which a piece shows
    nothing to compare it stays as it is.
    """
    held, rim = np.zeros(own.shape, np.float64), np.zeros(grid.hole.shape, bool)
    bend = np.zeros(own.shape, np.float64)
    beside = [grow(labels == i, 1) for i in range(len(colours))]
    for one, (made, there) in enumerate(zip(colours, valid, strict=True)):
        if (near := _find_window(beside[one] & grid.known)) is not None:
            step, sure = _average_step((own[near] - made[near]), there[near] & grid.known[near])
            edge = grid.known[near] & beside[one][near]
            told = edge & sure
            held[near][told], rim[near] = step[told], rim[near] | edge
        for other in range(one + 1, len(colours)):
            if (near := _find_window(beside[one] & beside[other])) is None:
                continue
            both = there[near] & valid[other][near] & grid.hole[near]
            step, sure = _average_step(made[near] - colours[other][near], both)
            bend_between(bend[near], step, sure, labels[near] == one, labels[near] == other)
    spanned = span_membrane(held, rim | grid.known, bend).astype(np.float32)
    # Beyond its part a piece is still seen a little, where it fades: its change goes on there.
    return [_extend(spanned, labels == i) for i in range(len(colours))]


def bend_between(bend: Floats, step: Colours, sure: Mask, one: Mask, other: Mask) -> None:
    """Add to `bend` [h, w, c] what makes the change step from cells of `one` to those of `other` beside them.

    As much on this side as is taken on that one: what is left over would glow far around.
    """
    for here, there in NEIGHBOURS:
        meet = (one & sure)[here] & (other & sure)[there]
        mean = (step[here] + step[there])[meet] / 2
        bend[here][meet] += mean
        bend[there][meet] -= mean


def _find_window(mask: Mask) -> tuple[slice, slice] | None:
    """Rows and columns of what is set, and as many around it as a step is averaged over; None where nothing is."""
    if not mask.any():
        return None
    spans = (np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0)))
    rows, columns = (slice(max(0, s[0] - 3 * SEAM), s[-1] + 1 + 3 * SEAM) for s in spans)
    return rows, columns


def _average_step(step: Colours, usable: Mask) -> tuple[Colours, Mask]:
    """A step [h, w, c] averaged over what is usable nearby and no edge, and where there is such."""
    usable = usable & (np.abs(step).max(-1) < MAX_STEP)
    share = cv2.GaussianBlur(usable.astype(np.float32), (0, 0), SEAM)
    mean = cv2.GaussianBlur(np.where(usable[..., None], step, np.float32(0)), (0, 0), SEAM).reshape(step.shape)
    return np.asarray(mean / np.maximum(share, 1e-6)[..., None], np.float32), share > 1e-3


def _extend(values: Colours, part: Mask) -> Colours:
    share = cv2.GaussianBlur(part.astype(np.float32), (0, 0), 2 * FEATHER)
    mean = cv2.GaussianBlur(np.where(part[..., None], values, np.float32(0)), (0, 0), 2 * FEATHER)
    mean = mean.reshape(values.shape) / np.maximum(share, 1e-6)[..., None]
    return np.where(part[..., None], values, mean).astype(np.float32)


def sample_cells(values: NDArray[np.floating], places: Floats) -> NDArray[np.float32]:
    """Values [n, c] of cells [h, w, c] at places [n, 2] among them, bilinear."""
    return sample_bilinear(values, places)
