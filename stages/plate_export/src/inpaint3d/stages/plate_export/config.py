"""Parameters of plate-export; defaults are the `standard` preset."""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.base import Closed


class Config(Closed):
    """How plates are made."""

    registration: bool = Field(
        default=True, description="whether depths are refined until other photos meet, and meet the hole's surround"
    )
    grain: bool = Field(default=True, description="whether what is smoother than the photo gets the photo's grain")
    plan_side: Annotated[int, Field(ge=64)] = Field(
        default=640, description="longest side of a photo, pixels, at which depths and colours are matched"
    )
    tile: Annotated[int, Field(ge=64)] = Field(
        default=1024, description="side, pixels, of the pieces in which a hole is filled: bounds memory"
    )
    photo_cache: Annotated[int, Field(ge=0)] = Field(
        default=512 * 2**20, description="bytes of decoded photos that are kept while others are filled from them"
    )
