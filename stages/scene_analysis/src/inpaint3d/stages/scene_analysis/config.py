"""Parameters of scene analysis: thresholds, and decisions taken out of its hands."""

from typing import Annotated

from pydantic import Field

from inpaint3d.contracts.models.artifacts.effects import EffectName
from inpaint3d.contracts.models.base import Closed, Positive, Share


class Config(Closed):
    """When an effect is worth its cost. `force` overrules what is measured; the plan then says so."""

    force: dict[EffectName, bool] = Field(
        default={}, description="effects switched on or off by hand, e.g. {exposure: on, view-dependence: off}"
    )
    far_radius: Positive = Field(
        default=2.5, description="scene units from the point of interest; what lies beyond is background"
    )
    far_share: Share = Field(
        default=0.02, description="contraction is on where more than this share of the sparse points is background"
    )
    distortion_px: Positive = Field(
        default=0.5, description="lens distortion is on where it moves the picture's corner by more pixels"
    )
    exposure_ev: Positive = Field(
        default=0.1, description="exposure is on where views differ by more (EV, 10 to 90 % of the views)"
    )
    view_dependence_ev: Positive = Field(
        default=0.08,
        description="view dependence is on where one pair of observations of a point in five differs in brightness by "
        "more (EV) between far apart directions than between near ones",
    )
    min_tracks: Annotated[int, Field(ge=1)] = Field(
        default=50, description="points with usable colours; below, colours decide nothing"
    )
