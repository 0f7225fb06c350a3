"""Parameters of the USD export; defaults are the `standard` preset."""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.base import Closed, Positive, Share

Count = Annotated[int, Field(ge=1)]


class Config(Closed):
    """How finely the scene is meshed and textured."""

    views: Annotated[int, Field(ge=2)] = Field(default=24, description="views whose depth is fused, spread evenly")
    render_longest_side: Count = Field(
        default=128,
        description="pixels of the views' depth; renders stored with a field are used where they are at least this big",
    )
    grid: Annotated[int, Field(ge=8, le=768)] = Field(
        default=256, description="cells along the longest side of the volume, in contracted space"
    )
    truncation_cells: Annotated[float, Field(ge=1, le=20)] = Field(
        default=3.0, description="distance at which the fused distance is cut, in cells"
    )
    opaque: Share = Field(default=0.5, description="pixels of a lower opacity see the dome behind everything")
    smallest_piece: Share = Field(
        default=0.002, description="connected pieces with a smaller share of the triangles are dropped as floaters"
    )
    triangles: Annotated[int, Field(ge=4)] = Field(default=20_000, description="the mesh is decimated to about so many")
    texture_size: Annotated[int, Field(ge=64, le=8192)] = Field(default=2048, description="texels; side of a texture")
    collision_pieces: Annotated[int, Field(ge=0, le=1024)] = Field(
        default=128, description="convex pieces that bodies collide with, at most; 0: none"
    )
    pictures: Count = Field(
        default=24, description="training views whose pictures the texture is made of, spread evenly"
    )
    original: bool = Field(default=True, description="the scene before inpainting, as another variant")
    metres_per_unit: Positive | None = Field(
        default=None, description="length of a scene unit; None: as pose-estimation found it, or unknown"
    )
    block: Count = Field(default=4096, description="rays rendered at once; bounds memory, changes no result")
