"""Pictures without their holes: what completion makes of every view, and what a person painted into some."""

from typing import Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, FrameName, RelativePath, Share

Invented = Literal["painted", "example", "prior", "smooth"]
Origin = Literal["photos", "painted", "example", "prior", "smooth"]
SOURCE_CODES: dict[Invented, int] = {"painted": 1, "example": 2, "prior": 3, "smooth": 4}
"""Codes of a source map for what no photo shows: a person, patches of the view itself, a prior, a smooth fill."""
FIRST_PHOTO = 16
"""Code of a source map: FIRST_PHOTO + i says that the colour is that of the photo of `views[i]`."""


class CompletedView(Closed):
    """A training view with its hole filled, in the view's own exposure; pixels that the photo knows are the photo's."""

    name: FrameName
    picture: RelativePath = Field(description="pictures/NAME.png: 8-bit sRGB, of the posed frame's size")
    sources: RelativePath = Field(
        description="sources/NAME.png: 16-bit, of the same size; for each pixel that was filled where it came from "
        "(1 painted, 2 example, 3 prior, 4 smooth, 16 + i the photo of view i of this artifact), 0 where nothing was"
    )
    depth: RelativePath | None = Field(
        default=None,
        description="depth/NAME.exr: depth.Z along the axis with the hole's surface completed, scene units, at the "
        "size of the field's renders; None where the method makes no surface",
    )
    copies: RelativePath | None = Field(
        default=None,
        description="copies/NAME.exr: copied.X, copied.Y, for pixels filled by example in this very view the pixel "
        "that they were copied from (whole numbers), -1 elsewhere; None where it is no reference view",
    )
    shares: dict[Origin, Share] = Field(default={}, description="of the pixels that were filled, by source")


class Painting(Closed):
    """What came of a painted view."""

    name: FrameName
    painted: Share = Field(description="of the hole, where the picture that was painted differs from the one asked for")
    ignored: Share = Field(description="of the pixels that were painted, those outside the mask: not looked at")


class Contradiction(Closed):
    """Two painted views of the same surfaces."""

    names: tuple[FrameName, FrameName]
    shared: Share = Field(description="of the painted pixels of the first, those whose surface the second paints too")
    difference: Share = Field(
        description="mean absolute difference of sRGB-encoded colours there, exposures evened out"
    )


class CompletedViews(Closed):
    """Every training view completed."""

    method: str = Field(description="how: photo-completion, classical, prior-samples")
    summary: str = Field(description="what came from where, in words")
    views: tuple[CompletedView, ...]
    reference_views: tuple[FrameName, ...] = Field(
        default=(), description="views in which what no photo shows was made up, in this order"
    )
    paintings: tuple[Painting, ...] = Field(default=(), description="what was painted, as the artifact had it")
    contradictions: tuple[Contradiction, ...] = ()


class PaintedView(Closed):
    """A view that somebody painted in: undistorted, of the photo's size, as it was asked for."""

    name: FrameName
    picture: RelativePath = Field(description="pictures/NAME.SUFFIX: as it was painted; 8 or 16 bits, or float")
    mask: RelativePath = Field(description="masks/NAME.png: 8-bit, above 127 where it may be painted")
    asked: RelativePath | None = Field(default=None, description="asked/NAME.png: the picture before it was painted in")


class PaintedViews(Closed):
    """Views that somebody painted in; where they contradict each other, the nearest one to a view counts there."""

    views: tuple[PaintedView, ...]
