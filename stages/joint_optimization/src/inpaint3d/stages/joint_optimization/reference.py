"""What lies behind the hole, the same from every view: recovered, or made up in a reference view, and carried.

Most of a hole is known to other photos, and is taken from them as sharp as they are. What none shows gets a surface and
colours in the view that misses most of it, and both are carried to the others, as reference-guided inpainting of
radiance fields does (Mirzaei et al. 2023, arXiv:2304.09677), until nothing is left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.reprojection import correspondences, sample_bilinear, sparse_depth
from inpaint3d.stages.joint_optimization.appearance import Recolour
from inpaint3d.stages.joint_optimization.membrane import membrane
from inpaint3d.stages.joint_optimization.scene import Mask, SceneView
from inpaint3d.stages.joint_optimization.shrink import Coarse, coarsened, enlarged, grown, witnessed
from inpaint3d.stages.joint_optimization.texture import synthesised, telea

REACH = 1.8
"""Patches are copied from surfaces this much further from the middle of a gap than its own edge is, in space."""
GAP = 5
"""Pixels across from which on a gap is one; less is a crack, and is closed smoothly."""
WORTH = 0.01
"""Share of a hole below which its gaps are not worth another reference view."""

Image = NDArray[np.float32]


@dataclass(eq=False)
class Completed:
    """A view on its way: picture [h, w, 3] in the mean appearance, 0 where `missing`.

    unsure: cells of `coarse` whose surface no photo shows; its depth says nothing there until they are settled.
    """

    view: SceneView
    coarse: Coarse
    picture: Image
    missing: Mask
    unsure: Mask

    @cached_property
    def depth(self) -> NDArray[np.float64]:
        """Depth z of every pixel [h, w], scene units."""
        # Disparity, since that is what is linear over a plane.
        size = (self.view.camera.width, self.view.camera.height)
        return 1 / cv2.resize(1 / self.coarse.depth.astype(np.float64), size, interpolation=cv2.INTER_LINEAR)

    @property
    def gaps(self) -> Mask:
        """What is missing, without its cracks."""
        return cv2.morphologyEx(self.missing.astype(np.uint8), cv2.MORPH_OPEN, np.ones((GAP, GAP), np.uint8)) > 0

    def fill(self, where: Mask, colours: Image) -> None:
        """Take `where` [h, w] from `colours` [h, w, 3]."""
        self.picture = np.where(where[..., None], colours, self.picture).astype(np.float32)
        self.missing = self.missing & ~where

    def settle(self, where: Mask, depth: NDArray[np.floating]) -> None:
        """Take the surface of the unsure cells `where` from `depth`, z [h, w] of the cells."""
        self.coarse = replace(self.coarse, depth=np.where(where, depth, self.coarse.depth).astype(np.float32))
        self.unsure = self.unsure & ~where
        self.__dict__.pop("depth", None)


def completed(
    views: Sequence[SceneView],
    depths: Mapping[str, NDArray[np.float32]],
    recolour: Recolour,
    *,
    witnesses: int,
    references: int,
    variety: float = 0.0,
    seed: int = 0,
) -> tuple[list[Completed], str]:
    """Each view with nothing missing and nothing unsure, and how they came about, in words.

    depths: by view, a depth map (scene units along the axis, any size) of a field that was fitted to known pixels
    alone. witnesses: other views that must know a surface for it to be taken from them; references: views in which
    what none shows is made up, at most; variety, seed: how freely (`texture.synthesised`).
    """
    made = [_started(view, depths[view.name], recolour.to_mean(view.image, i)) for i, view in enumerate(views)]
    photos = [m.picture for m in made]
    found = [_recovered(one, made, photos, index, witnesses) for index, one in enumerate(made)]
    for one, (sure, where, colours) in zip(made, found, strict=True):
        one.fill(where, colours)
        one.unsure = one.unsure & ~sure
    unknown = sum(int(m.missing.sum()) for m in made) / max(1, sum(int(v.hole.sum()) for v in views))
    used: list[str] = []
    while len(used) < references:
        reference = max(made, key=lambda m: int(m.gaps.sum()))
        if reference.gaps.sum() <= WORTH * reference.view.hole.sum():
            break
        used.append(reference.view.name)
        _close(reference)
        _fill_by_example(reference, variety, seed)
        for other in made:
            if other.missing.any():
                _carry(reference, other)
    for one in made:
        _close(one)
        one.fill(one.missing, telea(one.picture, one.missing))
    words = f"{1 - unknown:.0%} of what is masked as other photos show it, the rest by example"
    return made, f"{words} in {' and '.join(used)}" if used else words


def _started(view: SceneView, depth: NDArray[np.float32], picture: Image) -> Completed:
    coarse = coarsened(view, depth)
    # One cell inside: next to a mask its object shows through, and interpolation reads beyond.
    coarse = replace(coarse, known=~grown(~coarse.known))
    blank = np.where(view.known[..., None], picture, np.float32(0))
    return Completed(view, coarse, blank, view.hole.copy(), grown(coarse.hole))


def _close(one: Completed) -> None:
    """Give the unsure cells the surface that is spanned between the sure ones around them."""
    if one.unsure.any():
        one.settle(one.unsure, 1 / membrane(1 / one.coarse.depth, ~one.unsure))


def _recovered(
    own: Completed, all_views: Sequence[Completed], photos: Sequence[Image], index: int, least: int
) -> tuple[Mask, Mask, Image]:
    """What at least `least` other photos show of the masked surfaces: in which cells, in which pixels, and its colours
    in the one that looks from nearest the same side.
    """
    y, x = np.nonzero(own.coarse.hole)
    pixels = np.stack([x + 0.5, y + 0.5], -1)
    points = own.coarse.camera.unproject(pixels, own.coarse.depth[y, x])
    towards = _directions(points, own)
    count, best, closest = np.zeros(len(y), np.int64), np.full(len(y), -1), np.full(len(y), -np.inf)
    for other, there in enumerate(all_views):
        if other == index:
            continue
        seen = witnessed(there.coarse, points, own.coarse.camera, pixels)
        alike = np.where(seen, (_directions(points, there) * towards).sum(-1), -np.inf)
        count += seen
        best[alike > closest] = other
        closest = np.maximum(closest, alike)
    chosen = np.full(own.coarse.hole.shape, -1)
    chosen[y, x] = np.where(count >= least, best, -1)
    sure = chosen >= 0
    chosen = np.where(own.view.hole, enlarged(chosen, own.view.hole.shape), -1)
    where, colours = np.zeros_like(own.view.hole), own.picture.copy()
    for other in np.unique(chosen[chosen >= 0]):
        there = all_views[other].view
        y, x = np.nonzero(chosen == other)
        points = own.view.camera.unproject(np.stack([x + 0.5, y + 0.5], -1), own.depth[y, x])
        xy, z = there.camera.project(points)
        sound = _surely_known(there, xy, z)
        where[y[sound], x[sound]] = True
        colours[y[sound], x[sound]] = sample_bilinear(photos[other], xy[sound])
    return sure, where, colours


def _directions(points: NDArray[np.float64], seen_from: Completed) -> NDArray[np.float64]:
    towards = points - seen_from.view.camera.centre
    return towards / np.linalg.norm(towards, axis=-1, keepdims=True)


def _surely_known(view: SceneView, xy: NDArray[np.float64], z: NDArray[np.float64]) -> Mask:
    """Whether every pixel that interpolation at `xy` [n, 2] reads is known."""
    inside = view.camera.inside(xy, z)
    x, y = (np.where(inside, xy[:, axis], 0).astype(np.int64) for axis in (0, 1))
    return inside & (cv2.erode(view.known.astype(np.uint8), np.ones((3, 3), np.uint8))[y, x] > 0)


def _fill_by_example(one: Completed, variety: float, seed: int) -> None:
    """Close the cracks, then fill each gap from the surfaces around it."""
    gaps = one.gaps
    cracks = one.missing & ~grown(gaps)
    one.fill(cracks, telea(one.picture, one.missing))
    points = one.view.camera.unproject(one.view.camera.pixel_centres(), one.depth)
    count, parts = cv2.connectedComponents(one.missing.astype(np.uint8))
    for part in range(1, count):
        gap = parts == part
        middle = np.median(points[gap], 0)
        apart = np.linalg.norm(points - middle, axis=-1)
        near = apart < REACH * np.quantile(apart[gap], 0.9)
        source = near & ~one.missing & (one.view.known | one.view.hole)
        rows, columns = (slice(max(0, a.min() - GAP), a.max() + 1 + GAP) for a in np.nonzero(gap | source))
        box = (rows, columns)
        colours = one.picture.copy()
        blank = one.missing | ~(one.view.known | one.view.hole)
        colours[box] = synthesised(one.picture[box], blank[box], source[box], variety=variety, seed=seed)
        one.fill(gap, colours)


def _carry(reference: Completed, other: Completed) -> None:
    """Give another view what it misses and the reference view has by now: surface, then colours."""
    points = reference.view.camera.unproject(reference.view.camera.pixel_centres(), reference.depth)
    splat = sparse_depth(other.coarse.camera, points[reference.view.hole])
    other.settle(other.unsure & np.isfinite(splat), splat)
    settled = ~enlarged(other.unsure, other.missing.shape)
    xy, seen = correspondences(other.view.camera, other.depth, reference.view.camera, reference.depth)
    where = seen & settled & other.missing
    colours = other.picture.copy()
    colours[where] = sample_bilinear(reference.picture, xy[where])
    other.fill(where, colours)
