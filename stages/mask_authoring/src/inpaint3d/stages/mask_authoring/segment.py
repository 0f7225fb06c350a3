"""The object on one picture: GrabCut (Rother et al., SIGGRAPH 2004) seeded by points, a box, or a rough mask."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.colour import to_bytes
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.morphology import keep_parts_at
from inpaint3d.scene.planes import Plane
from inpaint3d.stages.mask_authoring.surroundings import show_plane
from inpaint3d.stages.mask_authoring.views import DepthView

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Trimap = NDArray[np.uint8]

BACKGROUND, OBJECT, MAYBE_BACKGROUND, MAYBE_OBJECT = 0, 1, 2, 3  # OpenCV's GC_ values

SEED_RADIUS = 0.01  # of the shorter side: a point stands for a small disc
# How far from the points the object may reach, as shares of the shorter side. Below, a mask is one texture patch;
# above, GrabCut's colour models are mostly background.
REACHES = (0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.28, 0.36, 0.45)
CUT_WEIGHT = 0.25  # weight against stability: decides between two neighbouring candidates, whose stability is the same
ALIKE = 0.05  # stability that makes no difference: a thing and what it stands on are often both stable
CLICKED_PLANE = 0.012  # of the depth: how near a plane a point was clicked on it
OWN_PLANE = 0.5  # share of a plane's pixels near the points from which the plane may be the object's own
NEAR, NEARBY = 0.1, 0.17  # reaches: within the first no pixel is ruled out by a plane; the second is "near the points"
SMALLEST = 0.003  # of the picture
DEPTH_RANGE = 0.35  # of the object's depth, to either side, is what its depth channel spans
SURELY_OUT = 2.5  # reaches from the points beyond which nothing is the object


@dataclass(frozen=True)
class Prompts:
    """What was pointed at, in pixels of the picture: points [n, 2] on the object and off it, and a box x0 y0 x1 y1."""

    points: Floats
    background: Floats
    box: tuple[float, float, float, float] | None = None

    def scaled(self, factor: Floats) -> "Prompts":
        """The same on a picture resampled by `factor` [2]."""
        box = None if self.box is None else tuple(np.array(self.box) * np.tile(factor, 2))
        return Prompts(self.points * factor, self.background * factor, box)


def segment(view: DepthView, prompts: Prompts, rounds: int, seed: int, planes: Sequence[Plane] = ()) -> Bools:
    """The object on a view's picture -> bool [h, w].

    A box bounds the object; without one the reach round the points is unknown, and is found by stability (see
    `_choose_stablest`). planes: of the scene, which an object stands on or hangs at. Nothing is found where only the
    points themselves would be.
    """
    shape = (view.camera.height, view.camera.width)
    depth = view.depth_at(view.camera.pixel_centres())
    anchors = prompts.points if len(prompts.points) else np.array(prompts.box).reshape(2, 2).mean(0, keepdims=True)
    features = add_depth(view.image(), depth, middle_depth(view.depth_at(anchors)))
    if prompts.box is not None:
        trimap = _mark_points(_box_trimap(shape, prompts.box), prompts)
        return _keep_marked(grabcut(features, trimap, rounds, seed), prompts.points)
    reach = _reach_of(view, depth, prompts.points)
    flat = _find_flat(view, prompts.points, reach, planes)
    masks, cut = [], []
    for share in REACHES:
        trimap = np.full(shape, MAYBE_BACKGROUND, np.uint8)
        trimap[reach <= share] = MAYBE_OBJECT
        trimap[(reach > SURELY_OUT * share) | flat] = BACKGROUND
        mask = _keep_marked(grabcut(features, _mark_points(trimap, prompts), rounds, seed), prompts.points)
        masks.append(mask)
        cut.append(float((reach[mask] > 0.95 * share).mean()) if mask.any() else 1.0)
    found = masks[_choose_stablest(masks, cut)]
    marked = _mark_points(np.full(shape, BACKGROUND, np.uint8), prompts) == OBJECT
    return found if (found & ~marked).any() else np.zeros(shape, bool)


def add_depth(image: Image, depth: Floats, middle: float | None) -> NDArray[np.uint8]:
    """What GrabCut looks at, uint8 [h, w, 3]: the two strongest colour components, and depth [h, w] round `middle`.

    GrabCut takes three channels. The third principal colour of a photo holds little, while an object mostly stands out
    from its surroundings in depth; its colour models learn how far depth is to be trusted. Without a surface at the
    object (`middle` None) the colours stay as they are.
    """
    if middle is None:
        return to_bytes(image)
    pixels = image.reshape(-1, 3).astype(np.float64)
    pixels = pixels - pixels.mean(0)
    variance, axes = np.linalg.eigh(pixels.T @ pixels / len(pixels))
    spread = max(float(np.sqrt(variance[-1])), 1 / 255)
    colour = (pixels @ axes[:, :0:-1] / (5 * spread) + 0.5).reshape(*depth.shape, 2)
    near = np.minimum(depth, middle * (1 + DEPTH_RANGE)) / middle - 1  # inf, no surface, counts as far
    return to_bytes(np.concatenate([near[..., None] / (2 * DEPTH_RANGE) + 0.5, colour], -1))


def middle_depth(depth: Floats) -> float | None:
    """Median of the finite depths; None where none is."""
    known = depth[np.isfinite(depth)]
    return float(np.median(known)) if known.size else None


def grabcut(features: NDArray[np.uint8], trimap: Trimap, rounds: int, seed: int) -> Bools:
    """Cut the object out by features [h, w, 3] and a trimap [h, w] of BACKGROUND to MAYBE_OBJECT -> bool [h, w].

    Only the box round what is not surely background, and a rim to learn its colours from, is looked at. A trimap
    without one of the two sides is its own answer.
    """
    rows, columns = np.nonzero(trimap != BACKGROUND)
    result = trimap == OBJECT
    if not len(rows):
        return result
    rim = max(4, int(0.25 * max(np.ptp(rows), np.ptp(columns))))
    y0, y1 = max(rows.min() - rim, 0), rows.max() + rim + 1
    x0, x1 = max(columns.min() - rim, 0), columns.max() + rim + 1
    crop = np.ascontiguousarray(trimap[y0:y1, x0:x1])
    is_object = (crop == OBJECT) | (crop == MAYBE_OBJECT)
    if is_object.any() and not is_object.all():
        pixels = np.ascontiguousarray(features[y0:y1, x0:x1])
        cv2.setRNGSeed(seed)  # its k-means starts at random
        models = np.zeros((1, 65)), np.zeros((1, 65))
        cv2.grabCut(pixels, crop, None, *models, rounds, cv2.GC_INIT_WITH_MASK)  # pyright: ignore[reportCallIssue, reportArgumentType]
        is_object = (crop == OBJECT) | (crop == MAYBE_OBJECT)
    result[y0:y1, x0:x1] = is_object
    return result


def iou(a: Bools, b: Bools) -> float:
    """Intersection over union; two empty masks agree."""
    union = int((a | b).sum())
    return 1.0 if union == 0 else int((a & b).sum()) / union


def _choose_stablest(masks: list[Bools], cut: list[float]) -> int:
    """The smallest candidate of those that change least when the reach is widened or narrowed by a step.

    An object ends where its colours and its surface do, so that a wider reach gives the same mask again; a mask that
    ends for want of reach grows with it, and `cut`, the share of it at the end of its reach, is large.
    """
    steps = [iou(a, b) for a, b in pairwise(masks)]
    agreement = np.array([steps[0], *map(max, steps, steps[1:]), steps[-1]])
    # A patch of texture is stable too: candidates too small to be the object that was meant are skipped.
    usable = np.array([m.mean() for m in masks]) >= SMALLEST
    score = np.where(usable, agreement - CUT_WEIGHT * np.array(cut), -1.0)
    return int(np.argmax(score >= score.max() - ALIKE))


def _find_flat(view: DepthView, points: Floats, reach: Floats, planes: Sequence[Plane]) -> Bools:
    """Pixels [h, w] a little away from the points that show a plane nobody pointed at, and that reaches beyond them."""
    flat = np.zeros(reach.shape, bool)
    clicked, there = view.depth_at(points), np.isfinite(view.depth_at(points))
    if not there.any():
        return flat
    seeds = view.camera.unproject(points[there], clicked[there])
    for plane in planes:
        on_it = show_plane(plane, view)
        pointed_at = plane.distance(seeds) <= CLICKED_PLANE * clicked[there]
        if not pointed_at.any() and on_it.any() and (reach[on_it] <= NEARBY).mean() < OWN_PLANE:
            flat |= on_it
    return flat & (reach > NEAR)


def _reach_of(view: DepthView, depth: Floats, points: Floats) -> Floats:
    """Distance [h, w] of each pixel's surface from the star between the points and their middle.

    Measured in space, so that what lies far behind the object is far from it, and expressed as a share of the shorter
    side as if at the points' own depth. Where the field has no surface at the points, measured on the picture.
    """
    camera = view.camera
    known = np.isfinite(depth)
    seeds_depth = view.depth_at(points)
    if np.isfinite(seeds_depth).any():
        surface = camera.unproject(camera.pixel_centres(), np.where(known, depth, 1.0))
        seen = np.isfinite(seeds_depth)
        seeds = camera.unproject(points[seen], seeds_depth[seen])
        pixel_size = float(np.median(seeds_depth[seen])) / camera.fx
    else:
        surface, seeds, pixel_size = camera.pixel_centres(), points, 1.0
        known = np.ones_like(known)
    middle = seeds.mean(0)
    nearest = np.full(depth.shape, np.inf)
    for seed in seeds:
        along = seed - middle
        length = float(along @ along)
        offset = surface[known] - middle
        t = np.clip(offset @ along / length, 0, 1) if length > 0 else np.zeros(len(offset))
        nearest[known] = np.minimum(nearest[known], np.linalg.norm(offset - t[:, None] * along, axis=-1))
    return nearest / (pixel_size * min(depth.shape))


def _mark_points(trimap: Trimap, prompts: Prompts) -> Trimap:
    radius = max(1, round(SEED_RADIUS * min(trimap.shape)))
    for points, value in ((prompts.background, BACKGROUND), (prompts.points, OBJECT)):
        for x, y in points:
            cv2.circle(trimap, (int(x), int(y)), radius, value, -1)
    return trimap


def _box_trimap(shape: tuple[int, ...], box: tuple[float, float, float, float]) -> Trimap:
    trimap = np.full(shape, BACKGROUND, np.uint8)
    x0, y0, x1, y1 = (round(max(v, 0.0)) for v in box)
    trimap[y0:y1, x0:x1] = MAYBE_OBJECT
    return trimap


def _keep_marked(mask: Bools, points: Floats) -> Bools:
    """The connected parts of a mask that hold one of the points (all parts where there are no points)."""
    return keep_parts_at(mask, points.astype(int)) if len(points) else mask
