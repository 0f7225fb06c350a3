"""A view on its way to being complete: what is known of it so far, of its surfaces and of its colours."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from inpaint3d.radiance.appearance import AppearanceMap
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.membrane import span_membrane
from inpaint3d.scene.morphology import grow, grow_square
from inpaint3d.scene.visibility import CoarseView, coarsen, enlarge_depth
from inpaint3d.stages.view_completion.surfaces import FlatScene

MIN_GAP = 5
"""Pixels across from which on a gap is one; less is a crack, and is closed smoothly."""
KNOWN_REACH, HOLE_REACH, SPANNED_REACH = 2.0, 4.0, 6.0
"""How many times as far off a plane depth may lie and is still taken for it: of known cells, of masked ones that the
field has from other views, and of what is spanned between these."""

Sources = NDArray[np.uint16]


@dataclass(eq=False)
class Draft:
    """A view on its way: picture [h, w, 3] in the mean appearance, 0 where `missing`; sources [h, w] of what is filled.

    unsure: cells of `coarse` whose surface no photo shows; its depth says nothing there until they are settled. flat:
    the planes of the scene, which depths keep to. copies: pixel (x, y) [h, w, 2] that each was copied from by example,
    -1 elsewhere; None where nothing was.
    """

    index: int
    view: MaskedView
    coarse: CoarseView
    picture: Image
    missing: Mask
    unsure: Mask
    sources: Sources
    flat: FlatScene
    copies: NDArray[np.float32] | None = None

    @cached_property
    def depth(self) -> NDArray[np.float64]:
        """Depth z of every pixel [h, w], scene units."""
        return enlarge_depth(self.coarse.depth, (self.view.camera.height, self.view.camera.width))

    @cached_property
    def surely_known(self) -> Mask:
        """Known pixels [h, w] around which all are known, so that interpolation reads nothing else."""
        return ~grow(~self.view.known, 1)

    @property
    def gaps(self) -> Mask:
        """What is missing, without its cracks."""
        core = ~grow_square(~self.missing, MIN_GAP // 2)
        return grow_square(core, MIN_GAP // 2)

    def fill(self, where: Mask, colours: Image, sources: Sources | int) -> None:
        """Take `where` [h, w] from `colours` [h, w, 3], which came from `sources` [h, w]."""
        self.picture = np.where(where[..., None], colours, self.picture).astype(np.float32)
        self.sources = np.where(where, sources, self.sources).astype(np.uint16)
        self.missing = self.missing & ~where

    def note_copies(self, where: Mask, places: NDArray[np.number]) -> None:
        """Remember which pixels (x, y) [n, 2] the n pixels of `where` [h, w] were copied from."""
        if self.copies is None:
            self.copies = np.full((*where.shape, 2), -1, np.float32)
        self.copies[where] = places

    def settle(self, where: Mask, depth: NDArray[np.floating]) -> None:
        """Take the surface of the unsure cells `where` from `depth`, z [h, w] of the cells."""
        self.coarse = replace(self.coarse, depth=np.where(where, depth, self.coarse.depth).astype(np.float32))
        self.unsure = self.unsure & ~where
        self.__dict__.pop("depth", None)


def start_draft(index: int, view: MaskedView, depth: NDArray[np.float32], picture: Image, flat: FlatScene) -> Draft:
    """A view of which nothing is filled. depth: z, scene units, any size; picture [h, w, 3] in the mean appearance."""
    coarse = coarsen(view, depth)
    # A cell beside the mask has as soft a depth as those behind it.
    coarse = flat.snap(coarse, np.where(grow(coarse.hole, 1), HOLE_REACH, KNOWN_REACH))
    # One cell inside: next to a mask its object shows through, and interpolation reads beyond.
    coarse = replace(coarse, known=~grow(~coarse.known, 1))
    blank = np.where(view.known[..., None], picture, np.float32(0))
    sources = np.zeros(view.hole.shape, np.uint16)
    return Draft(index, view, coarse, blank, view.hole.copy(), grow(coarse.hole, 1), sources, flat)


def span_unsure(draft: Draft) -> None:
    """Give the unsure cells the surface that is spanned between the sure ones around them.

    Where a view has no sure cell there is nothing to span: the field's own surface stays.
    """
    if draft.unsure.all():
        draft.settle(draft.unsure, draft.coarse.depth)
    elif draft.unsure.any():
        spanned = replace(draft.coarse, depth=1 / span_membrane(1 / draft.coarse.depth, ~draft.unsure))
        draft.settle(draft.unsure, draft.flat.snap(spanned, SPANNED_REACH).depth)


def restore_exposure(draft: Draft, appearance: AppearanceMap) -> Image:
    """The draft's picture in its view's own exposure; known pixels are the photo's own, to the bit."""
    own = appearance.from_mean(draft.picture, draft.index)
    return np.where(draft.view.hole[..., None], own, draft.view.image).astype(np.float32)
