"""What a hole is filled from: each piece gives colours for rays of the plate's camera, at any fineness."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES
from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.paintings import Painting
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.plate_export.colours import ColourMap, match_completed, match_photos, prepare_completed
from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.photo_files import Colours
from inpaint3d.stages.plate_export.photos import Photos, sample_cubic
from inpaint3d.stages.plate_export.views import PlateView

PAINTED, EXAMPLE = SOURCE_CODES["painted"], SOURCE_CODES["example"]


class Piece(Protocol):
    """Colours of a part of the hole."""

    def find_usable(self, rays: Floats, disparity: Floats) -> Mask:
        """Behind which rays [n, 2], at 1 / z [n], it has colours."""
        ...

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:
        """Colours [n, c] in the plate's codes behind rays [n, 2] at 1 / z [n], means of cells; and where it has any."""
        ...


@dataclass(frozen=True, eq=False)
class FromView:
    """Another photo, by depth: what it knows, or (`plate`) its plate, whatever it was filled from."""

    target: PlateView
    source: PlateView
    photos: Photos
    plate: bool = False
    checked: bool = False
    """Whether it is asked that the source sees the surface: completion has not said so."""

    @cached_property
    def colours(self) -> ColourMap:
        """What brings the source's codes to the plate's."""
        return match_photos(self.target, self.source, self.photos)

    def find_usable(self, rays: Floats, disparity: Floats) -> Mask:
        there, z = self._find(rays, disparity)
        return self._judge(there, z, self.source.camera.project(there))

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:
        there, z = self._find(rays, disparity)
        xy = self.source.camera.project(there)
        usable = self._judge(there, z, xy)
        made = np.zeros((len(rays), len(self.colours.offset)), np.float32)
        made[usable] = self.colours(self.photos.sample(self.source.name, xy[usable], cell, plate=self.plate))
        return made, usable

    def measure_turn(self, rays: Floats, disparity: Floats) -> NDArray[np.float64]:
        """Angles [n], radians, between the two cameras' lines of sight to the surfaces."""
        points = self.target.camera.to_world(rays, disparity)
        one, other = (v.camera.posed.centre - points for v in (self.target, self.source))
        cosine = (one * other).sum(-1) / (np.linalg.norm(one, axis=-1) * np.linalg.norm(other, axis=-1))
        return np.arccos(np.clip(cosine, -1, 1))

    def _find(self, rays: Floats, disparity: Floats) -> tuple[Floats, Floats]:
        return self.source.camera.to_rays(self.target.camera.to_world(rays, disparity))

    def _judge(self, there: Floats, z: Floats, xy: Floats) -> Mask:
        usable = (z > 0) & self.source.camera.inside(xy)
        if not self.plate:
            usable &= self.source.knows(there)
        return usable & self.source.sees(there, z) if self.plate or self.checked else usable


@dataclass(frozen=True, eq=False)
class Copied:
    """The view itself, from where completion copied patches; their light is changed as completion changed it."""

    view: PlateView
    photos: Photos
    colours: ColourMap

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:  # noqa: ARG002 - no depth
        view, (origin, there, usable) = self.view, self._find(rays)
        xy = view.camera.project(there)
        posed = view.camera.to_posed(rays)
        height, width = view.hole.shape
        x, y = posed[:, 0].astype(np.int64).clip(0, width - 1), posed[:, 1].astype(np.int64).clip(0, height - 1)
        column, row = (origin[:, axis].astype(np.int64).clip(0) for axis in (0, 1))
        filled, given = (
            prepare_completed(p, self.photos, view) for p in (view.picture[y, x], view.picture[row, column])
        )
        lighter = (filled - given) @ self.colours.matrix.T
        made = np.zeros((len(rays), len(self.colours.offset)), np.float32)
        made[usable] = self.photos.sample(view.name, xy[usable], cell, plate=True) + lighter[usable]
        return made, usable

    def find_usable(self, rays: Floats, disparity: Floats) -> Mask:  # noqa: ARG002 - no depth
        return self._find(rays)[2]

    def _find(self, rays: Floats) -> tuple[Floats, Floats, Mask]:
        """The posed view's pixels [n, 2] that were copied, rays [n, 2] to the copies' places, and which there are."""
        view, copies = self.view, _require(self.view.copies)
        posed = view.camera.to_posed(rays)
        height, width = view.hole.shape
        x, y = posed[:, 0].astype(np.int64).clip(0, width - 1), posed[:, 1].astype(np.int64).clip(0, height - 1)
        origin = copies[y, x].astype(np.float64)
        usable = np.asarray((origin >= 0).all(-1), bool)
        # Within a pixel of the posed view the photo goes on beside the origin as it does here.
        at = np.where(usable[:, None], origin, 0) + posed - np.floor(posed)
        there = (at - (view.camera.posed.cx, view.camera.posed.cy)) / (view.camera.posed.fx, view.camera.posed.fy)
        return origin, there, usable & view.camera.inside(view.camera.project(there))


@dataclass(frozen=True, eq=False)
class Painted:
    """What somebody painted on the canvas of this view."""

    view: PlateView
    photos: Photos
    colours: ColourMap
    painting: Painting

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:  # noqa: ARG002 - no depth
        camera = self.view.camera.canvas
        xy = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        colours = prepare_completed(sample_cubic(self.painting.picture, xy).clip(0, 1), self.photos, self.view)
        return self.colours(colours), self.find_usable(rays, disparity)

    def find_usable(self, rays: Floats, disparity: Floats) -> Mask:  # noqa: ARG002 - no depth
        camera = self.view.camera.canvas
        xy = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        x, y = (
            xy[:, axis].astype(np.int64).clip(0, side - 1) for axis, side in ((0, camera.width), (1, camera.height))
        )
        return self.painting.mask[y, x]


@dataclass(frozen=True, eq=False)
class Enlarged:
    """Completion's own picture, enlarged: where nothing finer is to be had."""

    view: PlateView
    photos: Photos
    colours: ColourMap

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:  # noqa: ARG002 - no depth
        srgb = sample_bilinear(self.view.picture, self.view.camera.to_posed(rays))
        return self.colours(prepare_completed(srgb, self.photos, self.view)), np.ones(len(rays), bool)

    def find_usable(self, rays: Floats, disparity: Floats) -> Mask:  # noqa: ARG002 - no depth
        return np.ones(len(rays), bool)


def _require(copies: object) -> np.ndarray:
    if not isinstance(copies, np.ndarray):
        raise TypeError("a view without copies has no piece that is copied")
    return copies


@dataclass(frozen=True, eq=False)
class Offer:
    """A piece, the source codes that it may fill, and for a photo the piece that fills what others were to."""

    codes: tuple[int, ...]
    piece: Piece
    seen: FromView | None = None


def choose_pieces(
    index: int,
    views: Sequence[PlateView],
    photos: Photos,
    codes: Sequence[int],
    plates: Sequence[int],
    painting: Painting | None,
) -> list[Offer]:
    """What fills the hole, in the order in which it is asked; the last can fill anything.

    codes: of the view's source map. plates: views whose plates are made, in the order in which they count.
    """
    view = views[index]
    completed = match_completed(view, photos)
    found: list[Offer] = []
    invented = tuple(code for code in codes if code < FIRST_PHOTO)
    if painting is not None:
        found.append(Offer((PAINTED,), Painted(view, photos, completed, painting)))
    for number, source in enumerate(views):
        if number != index and source.completed and _are_alike(view, source, photos):
            piece = FromView(view, source, photos)
            found.append(Offer((FIRST_PHOTO + number,), piece, replace(piece, checked=True)))
    if view.copies is not None:
        found.append(Offer((EXAMPLE,), Copied(view, photos, completed)))
    for number in plates:
        if number != index and _are_alike(view, views[number], photos):
            found.append(Offer(invented, FromView(view, views[number], photos, plate=True)))
    found.append(Offer((), Enlarged(view, photos, completed)))
    return found


def _are_alike(one: PlateView, other: PlateView, photos: Photos) -> bool:
    """Whether two photos' files hold the same kind of colours."""
    a, b = photos.file(one.name), photos.file(other.name)
    return (a.colours, a.linear) == (b.colours, b.linear)
