"""Views that somebody painted in: what was painted, what lies outside the mask, and whether anything was at all."""

from dataclasses import dataclass

import cv2
import numpy as np

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import PaintedView, PaintedViews
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.image_io import Image, Mask, read_image, read_mask
from inpaint3d.scene.morphology import close

TOUCHED = 3 / 255
"""Difference of a channel from which on a pixel was painted: less is another program's rounding."""
CLOSED = 0.01
"""Gaps in what was painted up to this share of the longest side are painted too: a brush leaves some as they are."""


@dataclass(frozen=True, eq=False)
class Painting:
    """picture: sRGB-encoded float32 [h, w, 3] of the photo's size, undistorted. mask: bool [h, w], painted, and inside
    what was asked for. ignored: share of the painted pixels that lie outside.
    """

    picture: Image
    mask: Mask
    ignored: float = 0.0


def read_painting(painted: Artifact[PaintedViews], view: PaintedView) -> Painting:
    """A painted view. BadInputError where it cannot be read, its size is not the one asked for, or nothing was painted
    inside the mask.
    """
    try:
        return _read_painting(painted, view)
    except BadInputError as error:
        # The file to repair is the user's; the store's copy of it is of no use to anybody.
        raise BadInputError(str(error).replace(f"{painted.root}/", "")) from error


def _read_painting(painted: Artifact[PaintedViews], view: PaintedView) -> Painting:
    picture = read_image(painted.path(view.picture))
    size = (picture.shape[1], picture.shape[0])
    file = view.picture.rpartition("/")[2]
    if view.asked is None:
        return Painting(picture, read_mask(painted.path(view.mask), size))
    asked = read_image(painted.path(view.asked))
    if asked.shape != picture.shape:
        raise BadInputError(
            f"painted view {file} is {size[0]}x{size[1]} but was asked for at {asked.shape[1]}x{asked.shape[0]}; "
            "paint in the picture that was exported, and save it at its own size"
        )
    allowed = read_mask(painted.path(view.mask), size)
    touched = np.abs(picture - asked).max(-1) > TOUCHED
    if not touched.any():
        raise BadInputError(f"painted view {file} is as it was asked for: paint inside its mask, or remove the file")
    inside = close(touched & allowed, max(1, round(CLOSED * max(size)))) & allowed
    if not inside.any():
        raise BadInputError(f"painted view {file} was painted outside its mask alone; paint where the mask is white")
    return Painting(picture, inside, float((touched & ~allowed).sum() / touched.sum()))


def reduce_painting(painting: Painting, name: str, width: int, height: int) -> Painting:
    """The painting at the size of its posed view. BadInputError where it has another shape, or is smaller."""
    given = (painting.picture.shape[1], painting.picture.shape[0])
    shrink = max(width, height) / max(given)
    if shrink > 1 or tuple(max(1, round(side * shrink)) for side in given) != (width, height):
        raise BadInputError(
            f"painted view {name} is {given[0]}x{given[1]} but the view is {width}x{height}; "
            "paint on the picture that was exported"
        )
    if given == (width, height):
        return painting
    picture = cv2.resize(painting.picture, (width, height), interpolation=cv2.INTER_AREA)
    share = cv2.resize(painting.mask.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)
    return Painting(np.asarray(picture, np.float32), share > 1 / 2, painting.ignored)
