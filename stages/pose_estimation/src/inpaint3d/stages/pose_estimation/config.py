"""Parameters of pose-estimation."""

from typing import Literal

from pydantic import Field

from inpaint3d.contracts.model import Closed


class Config(Closed):
    """How cameras are found, what is good enough, and how large the undistorted frames are."""

    cameras: Literal["auto", "known", "estimate"] = Field(
        default="auto",
        description="use the cameras that came with the capture, or find them from the pictures; auto: if all came",
    )
    feature_size: int = Field(
        default=1000, ge=16, description="longest side of the pictures that features are found on, pixels"
    )
    features: int = Field(default=4096, ge=16, description="most features in a picture")
    exhaustive_up_to: int = Field(
        default=60,
        ge=2,
        description="captures of at most so many pictures are matched all with all; larger ordered ones in sequence",
    )
    overlap: int = Field(default=12, ge=1, description="sequential matching: neighbours on either side")
    output_size: int = Field(
        default=480, ge=8, description="longest side of the undistorted frames, pixels (never enlarged)"
    )
    test_every: int = Field(default=8, ge=2, description="every so many frames one is held out")
    min_registered_share: float = Field(
        default=0.6, ge=0, le=1, description="gate: share of pictures that must register"
    )
    min_triangulation_angle: float = Field(
        default=1.5, ge=0, description="gate: median angle between rays to a point, degrees"
    )
    min_points: int = Field(default=100, ge=0, description="gate: sparse points")
