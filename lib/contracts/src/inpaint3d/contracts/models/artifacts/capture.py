"""A capture as photographed: frames, what the camera said of them, and the views kept back as truth."""

from typing import Annotated, Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Pose, Positive, RelativePath


class Exif(Closed):
    """What the camera recorded; absent values are None."""

    focal_px: Positive | None = Field(default=None, description="focal length in pixels of the stored frame")
    exposure_s: Positive | None = None
    iso: Positive | None = None
    f_number: Positive | None = None
    camera: str | None = Field(default=None, description="make and model")


class KnownCamera(Closed):
    """A camera that came with the data set, in the data set's own world; params in COLMAP's order for the model."""

    model: Literal["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"]
    params: tuple[Finite, ...]
    world_from_cam: Pose


class CapturedFrame(Closed):
    """One picture: sRGB-encoded 8-bit JPEG or PNG, upright (EXIF orientation already applied)."""

    name: FrameName
    path: RelativePath = Field(description="frames/NAME.jpg or .png")
    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]
    exif: Exif = Exif()
    camera: KnownCamera | None = None
    mask: RelativePath | None = Field(
        default=None, description="masks/NAME.png, 8-bit, > 127 inside the hole, same size as the frame"
    )


class Capture(Closed):
    """Frames of one static scene, in capture order."""

    layout: Literal["photos", "video", "colmap", "nerfstudio", "llff", "spin-nerf", "realestate10k"]
    ordered: bool = Field(description="neighbours in the list were taken one after the other")
    frames: tuple[CapturedFrame, ...]


class Truth(Closed):
    """Views that show what is really behind the mask; wired to evaluation alone. Masks in it are evaluation-only."""

    frames: tuple[CapturedFrame, ...]
