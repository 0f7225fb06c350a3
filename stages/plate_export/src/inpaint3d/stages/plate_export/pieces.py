"""What a hole is filled from: each piece gives colours for rays of the plate's camera, at any fineness."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from inpaint3d.contracts.models.artifacts.completion import FIRST_PHOTO, SOURCE_CODES, Origin
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.plate_export.colours import ColourMap, match_completed, match_photos, prepare_completed
from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.photo_files import Colours
from inpaint3d.stages.plate_export.photos import Photos, sample_cubic
from inpaint3d.stages.plate_export.views import PlateView

PAINTED, EXAMPLE = SOURCE_CODES["painted"], SOURCE_CODES["example"]


class Piece(Protocol):
    """Colours of a part of the hole."""

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:
        """Colours [n, c] in the plate's codes behind rays [n, 2] at 1 / z [n], means of cells; and where it has any."""
        ...


@dataclass(frozen=True, eq=False)
class FromView:
    """Another photo, by depth: what it knows, or (`plate`) its plate, whatever it was filled from."""

    target: PlateView
    source: PlateView
    photos: Photos
    colours: ColourMap
    plate: bool = False

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:
        there, z = self.source.camera.to_rays(self.target.camera.to_world(rays, disparity))
        usable = (z > 0) & (self.source.sees(there, z) if self.plate else self.source.knows(there))
        xy = self.source.camera.project(there)
        usable &= self.source.camera.inside(xy)
        made = np.zeros((len(rays), len(self.colours.offset)), np.float32)
        made[usable] = self.colours(self.photos.sample(self.source.name, xy[usable], cell, plate=self.plate))
        return made, usable


@dataclass(frozen=True, eq=False)
class Copied:
    """The view itself, from where completion copied patches; their light is changed as completion changed it."""

    view: PlateView
    photos: Photos
    colours: ColourMap

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:  # noqa: ARG002 - no depth
        view, copies = self.view, _require(self.view.copies)
        posed = view.camera.to_posed(rays)
        height, width = view.hole.shape
        x, y = posed[:, 0].astype(np.int64).clip(0, width - 1), posed[:, 1].astype(np.int64).clip(0, height - 1)
        origin = copies[y, x].astype(np.float64)
        usable = np.asarray((origin >= 0).all(-1), bool)
        # Within a pixel of the posed view the photo goes on beside the origin as it does here.
        there = np.where(usable[:, None], origin, 0) + posed - np.floor(posed)
        camera = view.camera.posed
        xy = view.camera.project((there - (camera.cx, camera.cy)) / (camera.fx, camera.fy))
        usable &= view.camera.inside(xy)
        column, row = (origin[:, axis].astype(np.int64).clip(0) for axis in (0, 1))
        filled, given = (
            prepare_completed(p, self.photos, view) for p in (view.picture[y, x], view.picture[row, column])
        )
        lighter = (filled - given) @ self.colours.matrix.T
        made = np.zeros((len(rays), len(self.colours.offset)), np.float32)
        made[usable] = self.photos.sample(view.name, xy[usable], cell, plate=True) + lighter[usable]
        return made, usable


@dataclass(frozen=True, eq=False)
class Painted:
    """What somebody painted on the canvas of this view: [h, w, 3] of the photo's size, sRGB, undistorted."""

    view: PlateView
    photos: Photos
    colours: ColourMap
    canvas: Image
    mask: Mask

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:  # noqa: ARG002 - no depth
        camera = self.view.camera.canvas
        xy = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
        x, y = (
            xy[:, axis].astype(np.int64).clip(0, side - 1) for axis, side in ((0, camera.width), (1, camera.height))
        )
        usable = self.mask[y, x]
        colours = prepare_completed(sample_cubic(self.canvas, xy).clip(0, 1), self.photos, self.view)
        return self.colours(colours), usable


@dataclass(frozen=True, eq=False)
class Enlarged:
    """Completion's own picture, enlarged: where nothing finer is to be had."""

    view: PlateView
    photos: Photos
    colours: ColourMap

    def sample(self, rays: Floats, disparity: Floats, cell: int) -> tuple[Colours, Mask]:  # noqa: ARG002 - no depth
        srgb = sample_bilinear(self.view.picture, self.view.camera.to_posed(rays))
        return self.colours(prepare_completed(srgb, self.photos, self.view)), np.ones(len(rays), bool)


def _require(copies: object) -> np.ndarray:
    if not isinstance(copies, np.ndarray):
        raise TypeError("a view without copies has no piece that is copied")
    return copies


@dataclass(frozen=True, eq=False)
class Canvas:
    """A painted view's picture [h, w, 3] in sRGB and where it was painted [h, w], of the photo's size, undistorted."""

    picture: Image
    mask: Mask


def choose_pieces(
    index: int,
    views: Sequence[PlateView],
    photos: Photos,
    codes: Sequence[int],
    plates: Sequence[int],
    canvas: Canvas | None,
) -> list[tuple[tuple[int, ...], Origin | None, Piece]]:
    """Pieces in the order in which they are asked: the source codes that each may fill, whose it is, and the piece.

    codes: of the view's source map. plates: views whose plates are made, in the order in which they count.
    """
    view = views[index]
    completed = match_completed(view, photos)
    found: list[tuple[tuple[int, ...], Origin | None, Piece]] = []
    invented = tuple(code for code in codes if code < FIRST_PHOTO)
    if canvas is not None:
        found.append(((PAINTED,), "painted", Painted(view, photos, completed, canvas.picture, canvas.mask)))
    for code in codes:
        if code >= FIRST_PHOTO and _alike(view, views[code - FIRST_PHOTO], photos):
            source = views[code - FIRST_PHOTO]
            found.append(((code,), "photos", FromView(view, source, photos, match_photos(view, source, photos))))
    if view.copies is not None:
        found.append(((EXAMPLE,), "example", Copied(view, photos, completed)))
    for number in plates:
        if number != index and _alike(view, views[number], photos):
            colours = match_photos(view, views[number], photos)
            found.append((invented, None, FromView(view, views[number], photos, colours, plate=True)))
    found.append((tuple(codes), None, Enlarged(view, photos, completed)))
    return found


def _alike(one: PlateView, other: PlateView, photos: Photos) -> bool:
    """Whether two photos' files hold the same kind of colours."""
    a, b = photos.file(one.name), photos.file(other.name)
    return (a.colours, a.linear) == (b.colours, b.linear)
