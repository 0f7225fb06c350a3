"""Lenses that bend straight lines: nested camera models, compared by their reprojection errors."""

from dataclasses import dataclass

import numpy as np

from inpaint3d.contracts.models.artifacts import Interval
from inpaint3d.scene.effects.description import Description, Finding

EFFECT = Description(
    name="lens-distortion",
    what="a lens that bends straight lines",
    evidence="nested camera models bundle-adjusted on the same matches: what the richer one moves the picture's corner "
    "by, and BIC of the reprojection errors",
    off_means="a pinhole; pictures are not resampled",
    simulated_by="inpaint3d.stages.pose_estimation.undistort.Undistorter",
    material=0.25,
    unit="pixels in the corner",
    criterion="BIC, nats",
)


@dataclass(frozen=True)
class LensTrial:
    """A camera model fitted to the capture. label: in words; parameters: numbers that it adds to a pinhole's.

    error_px: root mean square reprojection error; corner_px: how far it moves the corner against a pinhole of the same
    focal length.
    """

    label: str
    parameters: int
    error_px: float
    corner_px: float


def bic_gain(simple: LensTrial, rich: LensTrial, matches: float) -> float:
    """By how many nats the richer model is likelier, penalised: n ln(e0/e1) - k/2 ln n of n independent numbers."""
    extra = max(rich.parameters - simple.parameters, 0)
    floor = 1e-6
    return matches * np.log(max(simple.error_px, floor) / max(rich.error_px, floor)) - extra / 2 * np.log(
        max(matches, 2)
    )


def measure(pinhole: LensTrial, bent: LensTrial, matches: float) -> Finding:
    """matches: how many independent numbers the reprojection errors are: fewer than there are observations.

    The interval of the size is as wide as the noise lets it be: error / sqrt(matches), in the corner about twice that.
    """
    noise = 2 * 2 * bent.error_px / np.sqrt(max(matches, 1.0))
    size = Interval(value=bent.corner_px, low=bent.corner_px - noise, high=bent.corner_px + noise, unit=EFFECT.unit)
    gain = bic_gain(pinhole, bent, matches)
    words = (
        f"{bent.label} moves the picture's corner by {bent.corner_px:.2f} px; errors are {bent.error_px:.3f} px "
        f"against {pinhole.error_px:.3f} px of a pinhole"
    )
    return Finding(words, size, Interval(value=gain, low=gain, high=gain, unit="nats"), {"corner_px": bent.corner_px})
