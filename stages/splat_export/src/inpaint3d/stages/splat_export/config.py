"""Parameters of the splats; defaults are the `standard` preset."""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.artifacts import SplatFormat
from inpaint3d.contracts.models.base import Closed, Positive, Share

Count = Annotated[int, Field(ge=1)]


class Config(Closed):
    """How many splats, and how long they are fitted."""

    splats: Annotated[int, Field(ge=100, le=4_000_000)] = Field(default=120_000, description="at most so many")
    steps: Annotated[int, Field(ge=0)] = Field(
        default=240, description="of the fit, one training view each; 0: the splats as the field's depth places them"
    )
    position_rate: Positive = Field(
        default=0.15, description="learning rate of the places at first, in widths that a pixel of the depth has there"
    )
    similarity: Share = Field(default=0.2, description="weight of 1 - SSIM in the loss; the L1 difference has the rest")
    render_longest_side: Count = Field(
        default=128,
        description="pixels of the views' depth; renders stored with a field are used where they are at least this big",
    )
    opaque: Share = Field(default=0.3, description="pixels of a lower opacity see the dome behind everything")
    held_out_views: Annotated[int, Field(ge=0)] = Field(
        default=12, description="held-out photographs that the splats are scored on, at most, spread evenly; 0: none"
    )
    formats: Annotated[tuple[SplatFormat, ...], Field(min_length=1)] = Field(
        default=("ply", "spz", "glb", "usdc"), description="files to write: splats.FORMAT"
    )
    metres_per_unit: Positive | None = Field(
        default=None, description="length of a scene unit; None: as pose-estimation found it, or unknown"
    )
    block: Count = Field(default=4096, description="rays rendered at once; bounds memory, changes no result")
