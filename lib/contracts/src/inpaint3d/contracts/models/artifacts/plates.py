"""Clean plates: the photos at their own size with the hole filled, as a data set that other tools read."""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.artifacts.completion import Origin
from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Positive, RelativePath, Share

Side = Annotated[int, Field(ge=1)]


class CleanPlate(Closed):
    """A photo with its hole filled. Pixels outside the mask are the photo's own, bit for bit."""

    name: FrameName
    picture: RelativePath = Field(
        description="images/NAME.SUFFIX: upright, of the photo's size, bit depth, ICC profile and EXIF; PNG where the "
        "photo is a JPEG, so that nothing is quantised again, TIFF and OpenEXR as they are"
    )
    mask: RelativePath = Field(description="masks/NAME.png: 8-bit, 255 where the plate is not the photo's own")
    width: Side
    height: Side
    shares: dict[Origin, Share] = Field(default={}, description="of the pixels that were filled, by source")
    shift_px: Finite = Field(
        default=0.0, description="median shift by which registration moved what other photos show, pixels of the photo"
    )
    grain: Finite = Field(
        default=0.0, description="standard deviation of the photo's grain near the hole, of full range"
    )


class Canvas(Closed):
    """A view to paint in: undistorted, of the photo's size, 8-bit sRGB."""

    name: FrameName
    picture: RelativePath = Field(description="canvases/NAME.png: with the present fill")
    mask: RelativePath = Field(description="canvases/NAME.mask.png: 255 where it may be painted")
    cutout: RelativePath = Field(description="canvases/NAME.cutout.png: RGBA, transparent where it may be painted")


class PlateConsistency(Closed):
    """How alike neighbouring plates are, one warped to the other by depth; exposures evened out, codes of 0 to 1."""

    hole: Share = Field(description="mean absolute difference of pixels that were filled")
    known: Share = Field(description="the same of pixels that both photos know, within the hole's reach")
    ratio: Positive = Field(description="hole over known; about 1 where the plates agree as well as the photos do")
    pairs: int


class CleanPlates(Closed):
    """A plate for each photo, COLMAP's model of them as binary and text (`sparse/0/`), and `transforms.json`.

    Cameras are those of the photos, lens distortion included, in the source's own world (of known cameras: theirs).
    """

    plates: tuple[CleanPlate, ...]
    model: tuple[RelativePath, ...] = Field(
        description="sparse/0/{cameras,images,points3D}.{bin,txt} and what goes along"
    )
    transforms: RelativePath = "transforms.json"
    canvases: tuple[Canvas, ...] = Field(default=(), description="the views in which made-up surfaces are decided")
    consistency: PlateConsistency | None = Field(default=None, description="None where no two plates show the same")
