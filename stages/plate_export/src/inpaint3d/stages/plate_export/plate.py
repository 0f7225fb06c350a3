"""A photo's plate: the plan of its hole carried out at the photo's own size, tile by tile."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.completion import Origin
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.paintings import Painting
from inpaint3d.scene.source_maps import share_sources
from inpaint3d.stages.plate_export.config import Config
from inpaint3d.stages.plate_export.grain import add_grain
from inpaint3d.stages.plate_export.lens import Box
from inpaint3d.stages.plate_export.photo_files import Codes, Colours, to_codes, to_colours
from inpaint3d.stages.plate_export.photos import Photos
from inpaint3d.stages.plate_export.pieces import Copied, FromView, Offer, Piece, choose_pieces
from inpaint3d.stages.plate_export.plan import RING, Plan, assign_pieces, find_box, make_grid, make_plan, sample_cells
from inpaint3d.stages.plate_export.registration import refine_disparity
from inpaint3d.stages.plate_export.views import PlateView

FAINTEST = 0.01
"""Weight below which a piece is not asked for a pixel."""


@dataclass(frozen=True, eq=False)
class Plate:
    """codes [h, w, c] as the photo's file has them; filled [h, w]; what came from where; median shift of registration,
    pixels; standard deviation of the grain.
    """

    codes: Codes
    filled: Mask
    shares: dict[Origin, float]
    shift_px: float = 0.0
    grain: float = 0.0


def make_plate(
    index: int,
    views: Sequence[PlateView],
    photos: Photos,
    config: Config,
    *,
    plates: Sequence[int] = (),
    painting: Painting | None = None,
    seed: int = 0,
) -> Plate:
    """The photo of `views[index]` with its hole filled; every other pixel keeps its codes.

    plates: numbers of the views whose plates photos holds, those first whose made-up surfaces count more. painting:
    what was painted into this very view.
    """
    view = views[index]
    codes = photos.codes(view.name).copy()
    photos.put_plate(view.name, codes)  # filled below, in place
    filled = np.zeros(codes.shape[:2], bool)
    cell = max(1, -(-max(codes.shape[:2]) // config.plan_side))
    box = find_box(view, RING * cell)
    if box is None:
        return Plate(codes, filled, {})
    grid = make_grid(view, box, cell)
    present = [int(code) for code in np.unique(grid.codes[grid.hole])]
    offered = choose_pieces(index, views, photos, present, plates, painting)
    disparity, shift = view.disparity_at(grid.rays), 0.0
    if config.registration:
        labels = assign_pieces(grid, disparity, offered)
        disparity, shift = refine_disparity(view, photos, grid, disparity, _rank_photos(offered, labels))
    # What is copied within the view may lie on what other photos fill: those first.
    rounds = (
        [[o for o in offered if not isinstance(o.piece, Copied)], offered] if view.copies is not None else [offered]
    )
    plan: Plan | None = None
    for chosen in rounds:
        labels = assign_pieces(grid, disparity, chosen)
        plan = make_plan(view, photos, grid, disparity, [offer.piece for offer in chosen], labels)
        for tile in box.tiles(config.tile):
            _fill_tile(view, plan, chosen[-1].piece, tile, codes, filled, photos.file(view.name).colours)
    grain = 0.0
    if config.grain and plan is not None:
        grain = _match_grain(plan, codes, filled, photos.file(view.name).colours, np.random.default_rng([seed, index]))
    return Plate(codes, filled, share_sources(grid.codes[grid.hole]), shift, grain)


def _rank_photos(offered: Sequence[Offer], labels: NDArray[np.int64]) -> list[FromView]:
    """The photos that fill most first."""
    counts = np.bincount(labels[labels >= 0], minlength=len(offered))
    ranked = sorted(range(len(offered)), key=lambda i: -counts[i])
    found = [offered[i].piece for i in ranked if counts[i]]
    return [piece for piece in found if isinstance(piece, FromView) and not piece.plate]


def _fill_tile(
    view: PlateView, plan: Plan, fallback: Piece, tile: Box, codes: Codes, filled: Mask, channels: int
) -> None:
    """Fill the hole's pixels of a tile: pieces by their weights, each with its correction."""
    rays = view.camera.rays(tile)
    hole = view.covers(rays)
    if not hole.any():
        return
    places, rays = plan.grid.places(tile, hole), rays[hole]
    disparity = sample_cells(plan.disparity[..., None], places)[:, 0].astype(np.float64)
    colours, total = np.zeros((len(rays), channels), np.float32), np.zeros((len(rays), 1), np.float32)
    for piece, weights, correction in zip(plan.pieces, plan.weights, plan.corrections, strict=True):
        weight = sample_cells(weights[..., None], places)
        asked = weight[:, 0] > FAINTEST
        if asked.any():
            sampled, usable = piece.sample(rays[asked], disparity[asked], 1)
            share = np.where(usable[:, None], weight[asked], 0)
            colours[asked] += share * (sampled + sample_cells(correction, places[asked]))
            total[asked] += share
    empty = total[:, 0] < FAINTEST
    if empty.any():
        colours[empty], total[empty] = fallback.sample(rays[empty], disparity[empty], 1)[0], 1.0
    rows, columns = tile.slices
    made = np.full((len(rays), codes.shape[-1]), _find_opaque(codes), codes.dtype)
    made[:, :channels] = to_codes(colours / total, codes.dtype)
    codes[rows, columns][hole] = made
    filled[rows, columns] = hole


def _find_opaque(codes: Codes) -> float:
    return float(np.iinfo(codes.dtype).max) if codes.dtype.kind == "u" else 1.0


def _match_grain(plan: Plan, codes: Codes, filled: Mask, channels: int, rng: np.random.Generator) -> float:
    """Give the filled pixels the grain of the photo around them; returns it."""
    rows, columns = plan.grid.box.slices
    part: Codes = codes[rows, columns]
    hole = filled[rows, columns]
    colours: Colours = to_colours(part[..., :channels])
    h, w = hole.shape
    y, x = (np.arange(side) // plan.grid.cell for side in (h, w))
    at = np.ix_(y, x)
    labels = np.where(hole, plan.labels[at].clip(0), -1)
    ring = plan.grid.known[at] & ~hole
    noisy, grain = add_grain(colours, labels, ring, rng)
    part[..., :channels][hole] = to_codes(noisy[hole], codes.dtype)
    return grain
