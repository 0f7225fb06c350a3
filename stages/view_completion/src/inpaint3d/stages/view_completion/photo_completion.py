"""What lies behind the hole, the same from every view: recovered, or made up in a reference view, and carried.

Most of a hole is known to other photos, and is taken from them as sharp as they are. What none shows gets a surface and
colours in the view that misses most of it, and both are carried to the others, as reference-guided inpainting of
radiance fields does (Mirzaei et al. 2023, arXiv:2304.09677), until nothing is left.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Contradiction
from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES
from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.radiance.appearance import AppearanceMap
from inpaint3d.scene.cameras import measure_apart
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.paintings import Painting
from inpaint3d.scene.reprojection import correspondences, sample_bilinear, sparse_depth
from inpaint3d.scene.visibility import enlarge_cells, find_visible
from inpaint3d.stages.view_completion.completion import Completion
from inpaint3d.stages.view_completion.config import PhotoCompletion
from inpaint3d.stages.view_completion.drafts import (
    KNOWN_REACH,
    Draft,
    Sources,
    restore_exposure,
    span_unsure,
    start_draft,
)
from inpaint3d.stages.view_completion.gaps import fill_gaps
from inpaint3d.stages.view_completion.surfaces import FlatScene

MIN_SHARE = 0.01
"""Share of a hole below which its gaps are not worth another reference view."""
PAINTED, SMOOTH = SOURCE_CODES["painted"], SOURCE_CODES["smooth"]

Tick = Callable[[int, int, str], None]


def complete_from_photos(
    views: Sequence[MaskedView],
    depths: Mapping[str, NDArray[np.float32]],
    points: NDArray[np.float32],
    appearance: AppearanceMap,
    method: PhotoCompletion,
    *,
    seed: int,
    paintings: Mapping[str, Painting] | None = None,
    device: str = "cpu",
    tick: Tick | None = None,
) -> tuple[list[Completion], str, list[str], list[Contradiction]]:
    """Each view with nothing missing, how they came about in words, the views in which something was made up, and how
    paintings contradict each other.

    depths: by view, a depth map (scene units along the axis, any size) of a field that was fitted to known pixels
    alone. points: sparse points [n, 3] that no mask covers, scene units. paintings: by view, of its size; each counts
    in its own view, and elsewhere the one from nearest. device: where patches are compared.
    """
    say = tick or _ignore
    steps = len(views) + method.max_reference_views + len(paintings or {}) + 1
    flat = FlatScene.find(views, depths, points)
    drafts = [
        start_draft(i, view, depths[view.name], appearance.to_mean(view.image, i), flat) for i, view in enumerate(views)
    ]
    _recover_all(drafts, method.min_supporting_views, lambda done, message: say(done, steps, message))
    unknown = sum(int(d.missing.sum()) for d in drafts) / max(1, sum(int(v.hole.sum()) for v in views))
    painted = [d for d in drafts if d.view.name in (paintings or {})]
    for draft in painted:
        _take_painting(draft, (paintings or {})[draft.view.name], appearance)
    contradictions = find_contradictions(painted)
    for count, draft in enumerate(drafts if painted else ()):
        say(len(views) + min(count, len(painted) - 1), steps, f"carrying what was painted to {draft.view.name}")
        for reference in sorted(painted, key=lambda p: measure_apart(p.view.camera, draft.view.camera)):
            if reference is not draft:
                _carry(reference, draft)
    references: list[str] = []
    while len(references) < method.max_reference_views:
        reference = max(drafts, key=lambda d: int(d.gaps.sum()))
        if reference.gaps.sum() <= MIN_SHARE * reference.view.hole.sum():
            break
        references.append(reference.view.name)
        say(steps - 1 - method.max_reference_views + len(references), steps, f"making up {reference.view.name}")
        span_unsure(reference)
        fill_gaps(reference, method, seed, device)
        _carry_to_others(reference, drafts)
    for draft in drafts:
        span_unsure(draft)
        draft.fill(draft.missing, fill_telea(draft.picture, draft.missing), SMOOTH)
    made = [
        Completion(d.view.name, restore_exposure(d, appearance), d.sources, d.coarse.depth, d.copies) for d in drafts
    ]
    return made, _describe(unknown, list(paintings or {}), references), references, contradictions


def _ignore(done: int, total: int, message: str) -> None:
    """For callers who do not want to be told."""


def _describe(unknown: float, painted: Sequence[str], references: Sequence[str]) -> str:
    words = f"{1 - unknown:.0%} of what is masked as other photos show it"
    if painted:
        words += f", the rest as painted in {' and '.join(painted)}"
    words += ", the rest by example" if not painted else ", then by example"
    return f"{words} in {' and '.join(references)}" if references else words


def _recover_all(drafts: Sequence[Draft], min_supporting_views: int, tick: Callable[[int, str], None]) -> None:
    """Fill every draft with what other photos show; none of it is seen by another one's recovery."""
    photos = [d.picture for d in drafts]
    found = []
    for draft in drafts:
        tick(draft.index, f"looking for {draft.view.name} in other photos")
        found.append(_recover(draft, drafts, photos, min_supporting_views))
    for draft, (sure, where, colours, sources) in zip(drafts, found, strict=True):
        draft.fill(where, colours, sources)
        draft.unsure = draft.unsure & ~sure


def _recover(
    own: Draft, drafts: Sequence[Draft], photos: Sequence[Image], min_supporting_views: int
) -> tuple[Mask, Mask, Image, Sources]:
    """What enough other photos show of the masked surfaces: in which cells, in which pixels, their colours in the photo
    that looks from nearest the same side, and which one that is.
    """
    y, x = np.nonzero(own.coarse.hole)
    pixels = np.stack([x + 0.5, y + 0.5], -1)
    points = own.coarse.camera.unproject(pixels, own.coarse.depth[y, x])
    towards = _look_at(points, own)
    support, best, closest = np.zeros(len(y), np.int64), np.full(len(y), -1), np.full(len(y), -np.inf)
    for other in drafts:
        if other is own:
            continue
        visible = find_visible(other.coarse, points, own.coarse.camera, pixels)
        alike = np.where(visible, (_look_at(points, other) * towards).sum(-1), -np.inf)
        support += visible
        best[alike > closest] = other.index
        closest = np.maximum(closest, alike)
    chosen = np.full(own.coarse.hole.shape, -1)
    chosen[y, x] = np.where(support >= min_supporting_views, best, -1)
    sure = chosen >= 0
    chosen = np.where(own.view.hole, enlarge_cells(chosen, own.view.hole.shape), -1)
    where, colours = np.zeros_like(own.view.hole), own.picture.copy()
    for index in np.unique(chosen[chosen >= 0]):
        there = drafts[index]
        y, x = np.nonzero(chosen == index)
        points = own.view.camera.unproject(np.stack([x + 0.5, y + 0.5], -1), own.depth[y, x])
        xy, z = there.view.camera.project(points)
        sound = _find_surely_known(there, xy, z)
        where[y[sound], x[sound]] = True
        colours[y[sound], x[sound]] = sample_bilinear(photos[index], xy[sound])
    return sure, where, colours, (FIRST_PHOTO + chosen.clip(min=0)).astype(np.uint16)


def _look_at(points: NDArray[np.float64], draft: Draft) -> NDArray[np.float64]:
    """Unit directions [n, 3] in which a view's camera sees points [n, 3]."""
    towards = points - draft.view.camera.centre
    return towards / np.linalg.norm(towards, axis=-1, keepdims=True)


def _find_surely_known(draft: Draft, xy: NDArray[np.float64], z: NDArray[np.float64]) -> Mask:
    """Whether every pixel that interpolation at `xy` [n, 2] reads is known."""
    inside = draft.view.camera.inside(xy, z)
    x, y = (np.where(inside, xy[:, axis], 0).astype(np.int64) for axis in (0, 1))
    return inside & draft.surely_known[y, x]


def _take_painting(draft: Draft, painting: Painting, appearance: AppearanceMap) -> None:
    """What was painted counts wherever it was, also where other photos show something."""
    span_unsure(draft)
    painted = appearance.to_mean(painting.picture, draft.index)
    draft.fill(painting.mask & draft.view.hole, painted, PAINTED)


def find_contradictions(painted: Sequence[Draft]) -> list[Contradiction]:
    """For each pair of painted views that paint the same surfaces, how differently they do."""
    found: list[Contradiction] = []
    for one, other in itertools.combinations(painted, 2):
        own = one.sources == PAINTED
        xy, seen = correspondences(one.view.camera, one.depth, other.view.camera, other.depth)
        both = own & seen & (_trace_sources(other, xy, seen) == PAINTED)
        if both.any():
            apart = np.abs(one.picture[both] - sample_bilinear(other.picture, xy[both]))
            found.append(
                Contradiction(
                    names=(one.view.name, other.view.name),
                    shared=round(float(both.sum() / own.sum()), 6),
                    difference=round(min(1.0, float(apart.mean())), 6),
                )
            )
    return found


def _carry_to_others(reference: Draft, drafts: Sequence[Draft]) -> None:
    for other in drafts:
        if other is not reference and (other.missing.any() or (reference.sources == PAINTED).any()):
            _carry(reference, other)


def _carry(reference: Draft, other: Draft) -> None:
    """Give another view what it misses and the reference view has by now: surface, then colours.

    What was painted replaces whatever the other view has in its hole, unless that was painted before.
    """
    points = reference.view.camera.unproject(reference.view.camera.pixel_centres(), reference.depth)
    splat = sparse_depth(other.coarse.camera, points[reference.view.hole])
    found = other.unsure & np.isfinite(splat)
    # A cell gets the depth of what falls into it anywhere, and nearest: off its middle, and before the surface.
    carried = other.flat.snap(replace(other.coarse, depth=np.where(found, splat, other.coarse.depth)), KNOWN_REACH)
    other.settle(found, carried.depth)
    settled = ~enlarge_cells(other.unsure, other.missing.shape)
    xy, seen = correspondences(other.view.camera, other.depth, reference.view.camera, reference.depth)
    sources = _trace_sources(reference, xy, seen)
    replaced = (sources == PAINTED) & (other.sources != PAINTED) & other.view.hole
    where = seen & settled & (other.missing | replaced)
    colours = other.picture.copy()
    colours[where] = sample_bilinear(reference.picture, xy[where])
    other.fill(where, colours, sources)


def _trace_sources(reference: Draft, xy: NDArray[np.float64], seen: Mask) -> Sources:
    """Where the reference view has the colours at `xy` [h, w, 2] from; what it did not fill is its own photo's."""
    x, y = (np.where(seen, xy[..., axis], 0).astype(np.int64) for axis in (0, 1))
    found = reference.sources[y.clip(0, reference.missing.shape[0] - 1), x.clip(0, reference.missing.shape[1] - 1)]
    return np.where(found > 0, found, FIRST_PHOTO + reference.index).astype(np.uint16)
