"""What a capture must give before anything is built on it; each refusal names the figures and the repair."""

from dataclasses import dataclass

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.stages.pose_estimation.config import Config

PANORAMA_SHARE = 0.7


@dataclass(frozen=True)
class Evidence:
    """The figures that the gate decides on. `error_px` is at the captured size."""

    given: int
    registered: int
    unregistered: tuple[str, ...]
    model_sizes: list[int]
    verified_pairs: int
    turned_pairs: int
    median_inliers: float
    points: int
    angle_deg: float
    error_px: float
    longest_side: int


def check_estimated(e: Evidence, config: Config) -> None:
    """BadInputError where the photos cannot carry a scene."""
    needed = max(config.min_registered, round(config.min_registered_share * e.given))
    if e.registered < needed:
        raise BadInputError(_too_few(e, needed))
    if e.angle_deg < config.min_angle_deg:
        raise BadInputError(
            f"too little parallax: the median triangulation angle is {e.angle_deg:.2f} degrees, "
            f"{config.min_angle_deg} are needed; walk sideways between photos, don't turn on the spot"
        )
    if e.points < config.min_points:
        raise BadInputError(
            f"only {e.points} points were found in {e.registered} views, {config.min_points} are needed; "
            "photograph a scene with more texture, sharper, with more overlap"
        )
    _check_error(e, config, "use sharp photos of a scene that does not move, all with one lens and zoom")


def check_known(e: Evidence, config: Config) -> None:
    """BadInputError where the pictures contradict the cameras that came with them."""
    if e.points < config.min_points and e.verified_pairs * e.median_inliers > 20 * config.min_points:
        raise BadInputError(
            f"the cameras that came with the capture do not fit its pictures: {e.verified_pairs} pairs match with "
            f"{e.median_inliers:.0f} inliers each, but only {e.points} points triangulate; "
            "check their conventions, or set pose-estimation.cameras=estimate"
        )
    _check_error(e, config, "set pose-estimation.cameras=estimate to find the cameras from the pictures")


def _check_error(e: Evidence, config: Config, repair: str) -> None:
    allowed = config.largest_error_px * e.longest_side / 1000
    if e.error_px > allowed:
        raise BadInputError(
            f"the mean reprojection error is {e.error_px:.2f} px at {e.longest_side} px wide, "
            f"{allowed:.2f} are allowed; {repair}"
        )


def _too_few(e: Evidence, needed: int) -> str:
    shown = ", ".join(e.unregistered[:5]) + (", ..." if len(e.unregistered) > 5 else "")
    pairs = e.given * (e.given - 1) // 2
    counted = f"{e.registered} of {e.given} views could be placed, {needed} are needed"
    if e.verified_pairs and e.turned_pairs >= PANORAMA_SHARE * e.verified_pairs:
        return (
            f"{counted}: in {e.turned_pairs} of {e.verified_pairs} matching pairs the camera only turned "
            "(pure rotation); walk sideways between photos, don't turn on the spot"
        )
    if len(e.model_sizes) > 1 and e.model_sizes[1] >= 3:
        sizes = ", ".join(map(str, e.model_sizes))
        return (
            f"{counted}: the photos fall into {len(e.model_sizes)} models that do not meet (of {sizes} views); "
            "add photos between them, or give the scenes one by one"
        )
    return (
        f"{counted}: {e.verified_pairs} of {pairs} pairs match, with a median of {e.median_inliers:.0f} inliers; "
        f"take more photos that overlap by half and show one scene (not placed: {shown or 'none'})"
    )
