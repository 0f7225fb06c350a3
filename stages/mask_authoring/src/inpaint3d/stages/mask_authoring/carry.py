"""An object's mask carried from one view to all others (M2), the views nearest to those already done first.

For each view in turn: the object's surface points found so far are shown in it (z-test); GrabCut then decides round
them, where surface that earlier views put outside the object, or that lies far from it in space, is surely background;
what it finds is lifted and joins the object, so that sides which the first view cannot see are found from view to view.
At the end all views vote on every masked surface point: what an early view let in, later views put out.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.morphology import close, fill_holes, grow, shrink
from inpaint3d.stages.mask_authoring.cloud import Cloud, are_near, join, lift, splat, votes
from inpaint3d.stages.mask_authoring.segment import (
    BACKGROUND,
    MAYBE_BACKGROUND,
    MAYBE_OBJECT,
    OBJECT,
    add_depth,
    grabcut,
    middle_depth,
)
from inpaint3d.stages.mask_authoring.surroundings import Surroundings
from inpaint3d.stages.mask_authoring.views import DepthView, camera_distances, order_by_nearness

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.int64]

CLOSING = 0.01  # of the shorter side: gaps that splatting leaves
CORE = 0.008  # of the shorter side: how far depth may smear the object's outline
NEAR_WITNESSES = 8  # views that vote on a surface point while masks are carried; more change nothing
ALL_WITNESSES = 16  # views that vote when all masks are there, nearest first
UNSEEN = 0.15  # of the object's size: more of it is looked for up to this far from its known surface


@dataclass(frozen=True)
class Carrying:
    """How masks are carried; see `config.Config`."""

    tolerance: float
    margin: float
    rounds: int
    seed: int
    surroundings: Surroundings


def carry(
    views: list[DepthView],
    found: Mapping[int, Bools],
    how: Carrying,
    *,
    refine: bool,
    progress: Callable[[int, int], None],
) -> list[Bools]:
    """Masks [h, w] of the object in every view, given those in the views in which it was pointed at (one at least)."""
    apart = camera_distances([v.camera for v in views])
    masks = dict(found)
    clouds = [lift(views[i], shrink(mask, _pixels(CORE, mask))) for i, mask in found.items()]
    order = [i for i in order_by_nearness(apart, list(found)) if i not in found]
    for done, index in enumerate(order, start=1):
        progress(done, len(order))
        view, cloud = views[index], join(clouds)
        shown = splat(view, cloud, how.tolerance)
        shown = fill_holes(close(shown, _pixels(CLOSING, shown)), 0.1)
        if refine and shown.any():
            nearest = sorted(masks, key=apart[index].__getitem__)[:NEAR_WITNESSES]
            witnesses = Witnesses([views[j] for j in nearest], [masks[j] for j in nearest], how.tolerance)
            masks[index], surface = _refine(view, shown, cloud, witnesses, how)
            clouds.append(surface)
        else:
            masks[index] = shown
    carried = [masks[i] for i in range(len(views))]
    return _keep_agreed(views, carried, apart, how) if refine else carried


@dataclass(frozen=True, eq=False)
class Witnesses:
    """Views whose masks are known, asked about surface points."""

    views: Sequence[DepthView]
    masks: Sequence[Bools]
    tolerance: float

    def judge(self, points: Floats) -> tuple[Bools, Bools]:
        """Points [n] that are doubted (most of those who see them put them outside), and denied (so do two or more)."""
        inside, outside = votes(points, self.views, self.masks, self.tolerance)
        doubted = outside > inside
        return doubted, doubted & (inside + outside >= 2)


def _refine(view: DepthView, shown: Bools, cloud: Cloud, witnesses: Witnesses, how: Carrying) -> tuple[Bools, Cloud]:
    """The object in a view, segmented round what was carried there, and its surface points."""
    rows, columns = np.nonzero(shown)
    around = grow(shown, max(2, round(how.margin * max(np.ptp(rows), np.ptp(columns)))))
    pixels, points = _surface(view, around)
    doubted, denied = witnesses.judge(points)
    far = ~are_near(points, cloud, UNSEEN)
    outside, fresh = (_at(pixels, which, shown.shape) for which in (denied | far, ~doubted & ~far))
    core = shrink(shown, _pixels(CORE, shown)) & ~outside
    trimap = np.full(shown.shape, BACKGROUND, np.uint8)
    trimap[around & ~outside] = MAYBE_BACKGROUND
    # A surface next to the object that no view doubts may be its far side, seen for the first time. Where it is not,
    # later views reject it.
    trimap[(shown | fresh) & ~outside] = MAYBE_OBJECT
    trimap[core] = OBJECT
    # What the object stands on is seen anew from every side, in its colours where it is in its shade.
    trimap[how.surroundings.show(view) & ~shown] = BACKGROUND
    depth = view.depth_at(view.camera.pixel_centres())
    features = add_depth(view.image(), depth, middle_depth(depth[shown]))
    mask = grabcut(features, trimap, how.rounds, how.seed)
    found = lift(view, shrink(mask, _pixels(CORE, mask)))
    return mask, found.select(~witnesses.judge(found.points)[1] & ~how.surroundings.hold(found.points, view))


def _keep_agreed(views: list[DepthView], masks: list[Bools], apart: Floats, how: Carrying) -> list[Bools]:
    """The masks without the surface that views from near to far put outside the object."""
    agreed = []
    for index, (view, mask) in enumerate(zip(views, masks, strict=True)):
        others = np.argsort(apart[index], kind="stable")[1:]
        spread = others[:: max(1, len(others) // ALL_WITNESSES)]
        witnesses = Witnesses([views[j] for j in spread], [masks[j] for j in spread], how.tolerance)
        pixels, points = _surface(view, mask)
        agreed.append(mask & ~_at(pixels, witnesses.judge(points)[1], mask.shape))
    return agreed


def _surface(view: DepthView, mask: Bools) -> tuple[Indices, Floats]:
    """Pixels (row, column) [n, 2] of a mask that have a surface, and where it is [n, 3]."""
    rows, columns = np.nonzero(mask)
    xy = np.stack([columns, rows], -1) + 0.5
    z = view.depth_at(xy)
    known = np.isfinite(z)
    return np.stack([rows, columns], -1)[known], view.camera.unproject(xy[known], z[known])


def _at(pixels: Indices, chosen: Bools, shape: tuple[int, ...]) -> Bools:
    """The chosen [n] of the pixels (row, column) [n, 2] as a mask."""
    mask = np.zeros(shape, bool)
    mask[tuple(pixels[chosen].T)] = True
    return mask


def _pixels(share: float, mask: Bools) -> int:
    return max(1, round(share * min(mask.shape)))
