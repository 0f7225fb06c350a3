"""Parameters of capture-ingest; defaults are the `standard` preset."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.config import JsonDict

from inpaint3d.contracts.models.base import Closed

Layout = Literal["photos", "video", "colmap", "nerfstudio", "blender", "llff", "spin-nerf", "realestate10k"]


def _of(layout: Layout) -> JsonDict:
    """Of a parameter that counts for one layout, which may be found in the files."""
    return {"x-under": {"layout": ["auto", layout]}}


class Config(Closed):
    """How a source is read."""

    layout: Literal["auto"] | Layout = Field(
        default="auto", description="what the source is; auto: told by the files in it"
    )
    video_frames: Annotated[int, Field(ge=2, le=2000)] = Field(
        default=60,
        description="frames taken from a video, at most: the sharpest of as many stretches of equal motion",
        json_schema_extra=_of("video"),
    )
    spin_nerf_truth: Annotated[int, Field(ge=0)] = Field(
        default=40,
        description="first files of the SPIn-NeRF layout, which show the scene without the object",
        json_schema_extra=_of("spin-nerf"),
    )
    blender_truth: bool = Field(
        default=True,
        description="whether the test split of NeRF's synthetic layout is what views are scored against",
        json_schema_extra=_of("blender"),
    )
    realestate10k_clip: str | None = Field(
        default=None,
        description="the clip to take from a RealEstate10k folder; needed where it holds several",
        json_schema_extra=_of("realestate10k"),
    )
    realestate10k_frames: Annotated[int, Field(ge=2)] = Field(
        default=80,
        description="consecutive frames that are taken of the clip, from its first (S1)",
        json_schema_extra=_of("realestate10k"),
    )
    realestate10k_rows: Annotated[int, Field(ge=16)] = Field(
        default=360,
        description="rows that its frames are brought to (S1)",
        json_schema_extra=_of("realestate10k"),
    )
