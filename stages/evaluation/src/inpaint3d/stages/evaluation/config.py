"""Parameters of the evaluation; defaults are the `standard` preset."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from inpaint3d.contracts.models.base import Closed, Share

Count = Annotated[int, Field(ge=1)]


class Config(Closed):
    """What is measured, on how many views, at what size."""

    render_longest_side: Count = Field(
        default=320, description="pixels; photos, truth and renders are compared at this size (photos never enlarged)"
    )
    truth_views: Annotated[int, Field(ge=0)] = Field(
        default=20, description="views scored against the truth at most, spread evenly; 0: none"
    )
    held_out_views: Annotated[int, Field(ge=0)] = Field(
        default=4, description="test-split views scored at most, spread evenly; 0: none"
    )
    neighbour_views: Annotated[int, Field(ge=0)] = Field(
        default=2, description="views compared with their nearest neighbour's render at most; 0: none"
    )
    box_growth: Share = Field(
        default=0.1, description="share by which the mask's bounding box grows in width and height (E1)"
    )
    box_protocol: Literal["bbox", "spin-nerf"] = Field(
        default="bbox",
        description="what the crops are called: by their growth (bbox10-vgg), or spin-nerf, whose published figures "
        "are of the same crops at a quarter of the photos' size (1008 px)",
    )
    full_views: Annotated[int, Field(ge=0)] = Field(
        default=3,
        description="truth views that are scored whole as well, spread evenly; 0: none",
        json_schema_extra={"x-unless": {"truth_views": 0}},
    )
    held_out_pixels: Annotated[int, Field(ge=0)] = Field(
        default=1024,
        description="known pixels of each held-out photo scored as learning curves are; 0: none; "
        "joint-optimization's score_pixels",
    )
    ring: Share = Field(
        default=0.08,
        description="width of the ring around the mask, a share of the box's longer side, at least 2 px",
    )
    perceptual: bool = Field(default=True, description="LPIPS over both networks, FD-lite0 and KID-lite0")
    picture_views: Annotated[int, Field(ge=0)] = Field(default=3, description="views shown side by side, of each kind")
    contact_longest_side: Count = Field(
        default=480, description="pixels; size of one panel of before_mask_after_depth.png"
    )
    block: Count = Field(default=4096, description="rays rendered at once; bounds memory, changes no result")

    @model_validator(mode="after")
    def _check_protocol(self) -> "Config":
        if self.box_protocol == "spin-nerf" and (self.box_growth != 0.1 or self.render_longest_side < 1008):
            raise ValueError(
                f"spin-nerf is a box_growth of 0.1 at 1008 px, not {self.box_growth} at {self.render_longest_side} px; "
                "set render_longest_side: 1008 (and pose-estimation's output_longest_side), or leave box_protocol"
            )
        return self
