"""A capture as photographed: frames, what the camera said of them, and the views kept back as truth."""

from collections import Counter
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Pose, Positive, RelativePath, Vector3

# What photographers deliver and the wheel of OpenImageIO reads.
PICTURE_SUFFIXES = frozenset(
    [".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr", ".hdr", ".webp", ".bmp", ".jp2", ".ppm", ".tga"]
)
VIDEO_SUFFIXES = frozenset([".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v"])
_RAW = "develop to 16-bit TIFF or JPEG with darktable-cli or RawTherapee"
# Pictures that need another program first: suffix -> what to do.
UNREADABLE_SUFFIXES = {
    **dict.fromkeys([".heic", ".heif"], "convert to JPEG with `heif-convert -q 95` (libheif)"),
    ".avif": "convert to PNG with avifdec (libavif)",
    **dict.fromkeys([".dng", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".raf", ".pef"], _RAW),
}


class Exif(Closed):
    """What the camera recorded; absent values are None."""

    focal_px: Positive | None = Field(default=None, description="focal length in pixels of the stored frame")
    exposure_s: Positive | None = None
    iso: Positive | None = None
    f_number: Positive | None = None
    camera: str | None = Field(default=None, description="make and model")
    position: Vector3 | None = Field(default=None, description="by GPS: latitude, longitude in degrees, altitude in m")


class KnownCamera(Closed):
    """A camera that came with the data set, in the data set's own world; params in COLMAP's order for the model."""

    model: Literal[
        "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV",
        "OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE",
    ]  # fmt: skip
    params: tuple[Finite, ...]
    world_from_cam: Pose


class CapturedFrame(Closed):
    """One picture: sRGB-encoded 8-bit JPEG or PNG, upright (EXIF orientation already applied).

    Where a PNG has alpha of at most 127, nothing was photographed: such a pixel is no evidence, whatever its colour.
    """

    name: FrameName
    path: RelativePath = Field(description="frames/NAME.jpg or .png")
    original: RelativePath | None = Field(
        default=None,
        description="originals/NAME.SUFFIX: the photo as it was given, byte for byte, where the frame is not that file "
        "already (more bits, another profile, a turn by EXIF, alpha); None where it is, or where there was no file",
    )
    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]
    exif: Exif = Exif()
    camera: KnownCamera | None = None
    other_pose: Pose | None = Field(
        default=None,
        description="the camera's pose where cameras without names follow the pictures' names as numbers, not as text; "
        "pose-estimation takes the order that the pictures support",
    )
    mask: RelativePath | None = Field(
        default=None, description="masks/NAME.png, 8-bit, > 127 inside the hole, same size as the frame"
    )


def _check_names(frames: tuple[CapturedFrame, ...]) -> tuple[CapturedFrame, ...]:
    names = [frame.name for frame in frames]
    if twice := sorted({name for name, count in Counter(names).items() if count > 1}):
        raise ValueError(f"{len(twice)} names are of several frames: {', '.join(twice[:3])}")
    return frames


Frames = Annotated[tuple[CapturedFrame, ...], AfterValidator(_check_names)]


class Capture(Closed):
    """Frames of one static scene, in capture order."""

    layout: Literal["photos", "video", "colmap", "nerfstudio", "blender", "llff", "spin-nerf", "realestate10k"]
    ordered: bool = Field(description="neighbours in the list were taken one after the other")
    frames: Frames


class Truth(Closed):
    """Views that show what is really behind the mask; wired to evaluation alone. Masks in it are evaluation-only."""

    frames: Frames
