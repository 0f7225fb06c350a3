"""Parameters of pose estimation; defaults are the `standard` preset."""

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.config import JsonDict

from inpaint3d.contracts.models.base import Closed, Finite, Positive, Share

Count = Annotated[int, Field(ge=1)]
OF_ESTIMATES: JsonDict = {"x-unless": {"cameras": "known"}}


class Marker(Closed):
    """Printed markers of known size that lie in the scene."""

    dictionary: Literal[
        "DICT_4X4_50", "DICT_5X5_100", "DICT_6X6_250", "DICT_ARUCO_ORIGINAL", "DICT_APRILTAG_16h5",
        "DICT_APRILTAG_25h9", "DICT_APRILTAG_36h11",
    ] = Field(default="DICT_4X4_50", description="OpenCV's name of the markers' family")  # fmt: skip
    side_m: Positive = Field(description="metres; side of a marker's black square")


Pixel = tuple[Finite, Finite]


class Distance(Closed):
    """Two points of the scene whose distance was measured."""

    metres: Positive
    pixels: Annotated[dict[str, tuple[Pixel, Pixel]], Field(min_length=2)] = Field(
        description="view -> the two points, in pixels of the captured picture; in two views or more"
    )


class Config(Closed):
    """How cameras are found, and what the gate asks of them."""

    cameras: Literal["auto", "known", "estimate"] = Field(
        default="auto", description="auto: cameras that came with every frame are kept, else they are estimated"
    )
    lens: Literal["auto", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"] = Field(
        default="auto",
        description="camera model to estimate; auto: the simplest that the reprojection errors support",
        json_schema_extra=OF_ESTIMATES,
    )
    force: dict[Literal["lens-distortion"], bool] = Field(
        default={}, description="lens-distortion switched on or off by hand; with `lens` at auto"
    )
    feature_longest_side: Annotated[int, Field(ge=64)] = Field(
        default=640, description="pixels; pictures are reduced to this before features are looked for"
    )
    features: Annotated[int, Field(ge=64)] = Field(default=4096, description="features per picture, at most")
    matching: Literal["auto", "exhaustive", "sequential"] = Field(
        default="auto", description="auto: sequential for ordered captures of more than `exhaustive_up_to` frames"
    )
    exhaustive_up_to: Count = Field(
        default=25,
        description="frames; ordered captures up to this many match all pairs",
        json_schema_extra={"x-under": {"matching": "auto"}},
    )
    overlap: Count = Field(
        default=10,
        description="frames; how far ahead sequential matching looks",
        json_schema_extra={"x-unless": {"matching": "exhaustive"}},
    )
    truth_partners: Count = Field(default=16, description="frames that each truth view is matched with, spread evenly")
    source_metres_per_unit: Positive | None = Field(
        default=None,
        description="metres; a unit of the cameras that came with the capture, where it is known",
    )
    marker: Marker | None = Field(default=None, description="markers of known size, for the scale")
    distance: Distance | None = Field(default=None, description="a measured distance, for the scale")
    output_longest_side: Annotated[int, Field(ge=16)] = Field(
        default=480, description="pixels; undistorted frames are at most this long (never enlarged)"
    )
    test_every: Annotated[int, Field(ge=0)] = Field(
        default=8, description="every so many frames one is held out, from the first; 0: none"
    )
    keep_test_from: Count = Field(
        default=6,
        description="frames; captures of fewer hold none out",
        json_schema_extra={"x-unless": {"test_every": 0}},
    )
    min_registered_share: Share = Field(
        default=0.6, description="share of the frames that must be registered", json_schema_extra=OF_ESTIMATES
    )
    min_registered: Annotated[int, Field(ge=2)] = Field(
        default=3, description="frames that must be registered", json_schema_extra=OF_ESTIMATES
    )
    min_angle_deg: Annotated[float, Field(ge=0)] = Field(
        default=1.5,
        description="degrees; median triangulation angle below which depth cannot be told",
        json_schema_extra=OF_ESTIMATES,
    )
    min_points: Count = Field(default=20, description="sparse points that must be found")
    min_agreement: Share = Field(
        default=0.7, description="share of the verified matches that must agree with the cameras; 0: whatever they say"
    )
    min_view_agreement: Share = Field(
        default=0.4,
        description="the same of each single view of cameras that came with the capture",
        json_schema_extra={"x-unless": {"min_agreement": 0, "cameras": "estimate"}},
    )
    largest_epipolar_px: Positive = Field(
        default=4.0,
        description="pixels at the captured size per 1000 of its longest side; how far from its epipolar line a match "
        "may be to agree with cameras",
    )
    largest_error_px: Positive = Field(
        default=4.0, description="pixels at the captured size per 1000 of its longest side; mean reprojection error"
    )

    @model_validator(mode="after")
    def _check_force(self) -> "Config":
        if self.force and (self.lens != "auto" or self.cameras == "known"):
            what = f"lens={self.lens}" if self.lens != "auto" else "cameras=known"
            raise ValueError(f"lens-distortion is forced and {what} decides it too; leave one out")
        return self

    @model_validator(mode="after")
    def _check_scale(self) -> "Config":
        told = [name for name in ("source_metres_per_unit", "distance", "marker") if getattr(self, name) is not None]
        if len(told) > 1:
            raise ValueError(f"{' and '.join(told)} both tell the scale, of which one would count; leave one out")
        return self
