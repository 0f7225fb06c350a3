"""Parameters of mask authoring. What is to be masked is the mask request's to say, not theirs."""

from typing import Annotated, Literal

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Positive, Share


class Config(Closed):
    """How masks are found and carried from view to view."""

    depth_tolerance: Positive = Field(
        default=0.05,
        description="z-test: two depths are of one surface within this share of the depth (error of the field's depth)",
    )
    refine: bool = Field(
        default=True,
        description="segment each view again round the carried object, so that sides the source view misses are found",
    )
    margin: Share = Field(
        default=0.15,
        description="how far beyond the carried object refinement looks, as a share of its size in the view",
        json_schema_extra={"x-under": {"refine": True}},
    )
    segment_size: Annotated[int, Field(ge=16)] = Field(
        default=256, description="pixels; objects are segmented on pictures whose longest side is at most this"
    )
    grabcut_rounds: Annotated[int, Field(ge=1, le=20)] = Field(
        default=5,
        description="GrabCut iterations on the request's view",
        json_schema_extra={"x-without": "segmenter"},
    )
    refine_rounds: Annotated[int, Field(ge=1, le=20)] = Field(
        default=3,
        description="GrabCut iterations on each view that the object is carried to",
        json_schema_extra={"x-under": {"refine": True}},
    )
    edge_rounds: Annotated[int, Field(ge=1, le=20)] = Field(
        default=2, description="GrabCut iterations along the outline, at the pictures' own size"
    )
    voxels: Annotated[int, Field(ge=8, le=256)] = Field(
        default=72, description="cells along the longest side of the voxel hull"
    )
    hole: Literal["object", "unseen"] = Field(
        default="object",
        description="what the field is fitted to completed views in: all that is masked, or what of it no other view "
        "shows (of an outpainting, always all); completed views have all that is masked filled",
    )
    agreement: Share = Field(
        default=0.9, description="a voxel is the object's where this share of the views that can tell see it inside"
    )
