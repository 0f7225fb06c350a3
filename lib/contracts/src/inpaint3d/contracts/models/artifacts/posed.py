"""Frames without distortion, with cameras in the normalised world, and the sparse points between them."""

from typing import Annotated, Literal

from pydantic import Field

from inpaint3d.contracts.models.artifacts.effects import Effect
from inpaint3d.contracts.models.base import Closed, Finite, FrameName, Pose, Positive, RelativePath, Share, Vector3


class LensModel(Closed):
    """A lens as pose estimation decided it: COLMAP model name and parameters at the captured size."""

    model: str
    params: tuple[Finite, ...]
    evidence: str = Field(description="why this model: what a simpler and a richer one measured")


class PosedFrame(Closed):
    """An undistorted pinhole view (8-bit PNG) with its camera in the normalised world."""

    name: FrameName
    path: RelativePath = Field(description="frames/NAME.png")
    width: Annotated[int, Field(ge=1)]
    height: Annotated[int, Field(ge=1)]
    fx: Positive
    fy: Positive
    cx: Finite
    cy: Finite
    world_from_cam: Pose
    split: Literal["train", "test"] = "train"
    lens: LensModel | None = Field(
        default=None, description="the lens that took the captured frame, where it is not the capture's"
    )
    relative_exposure: Positive | None = Field(
        default=None, description="EXIF exposure_s * iso / f_number^2 over the median of the capture"
    )
    mask: RelativePath | None = Field(default=None, description="masks/NAME.png: mask that came with the capture")
    valid: RelativePath | None = Field(
        default=None, description="valid/NAME.png: pixels that the undistorted view really has; None = all"
    )


class Registration(Closed):
    """How pose estimation went; the figures behind its gate."""

    source: Literal["estimated", "known"]
    given: int
    registered: int
    unregistered: tuple[FrameName, ...] = ()
    mean_reprojection_error_px: Finite
    agreement: Share | None = Field(
        default=None, description="share of the verified matches between its views that agree with the cameras"
    )
    points: int
    median_triangulation_angle_deg: Finite


class MetricScale(Closed):
    """How long a scene unit is."""

    metres_per_unit: Positive
    uncertainty: Positive = Field(description="one standard deviation, as a share of the scale")
    evidence: str


class PosedCapture(Closed):
    """Cameras, undistorted frames and sparse points in the normalised world.

    World: z up, the point of interest at the origin, every camera centre within the unit ball.
    `points.safetensors`: xyz float32 [p, 3], rgb uint8 [p, 3], error float32 [p] (px), and tracks in compressed
    rows: track_offsets int64 [p + 1] into track_frame int32 [t] (index into `frames`) and track_xy float32 [t, 2]
    (pixels of the undistorted view).
    """

    frames: tuple[PosedFrame, ...]
    ordered: bool
    points: RelativePath = "points.safetensors"
    lens: LensModel
    lens_effect: Effect | None = Field(
        default=None, description="whether the lens bends the pictures, decided where it was estimated"
    )
    registration: Registration
    source_from_normalised_scale: Positive = Field(description="length of one scene unit in the source's units")
    scale: MetricScale | None = Field(default=None, description="of the normalised world; None: nothing tells")
    source_from_normalised: Pose = Field(description="similarity: source = M[:, :3] @ normalised + M[:, 3]")
    centre_depth: Positive = Field(description="median distance of cameras to the point of interest, scene units")
    up_evidence: str
    interest: Vector3 = (0.0, 0.0, 0.0)


class PosedTruth(Closed):
    """Truth views registered against the fixed model; they triangulate nothing."""

    frames: tuple[PosedFrame, ...]
    registered_share: Share
    mean_reprojection_error_px: Finite
