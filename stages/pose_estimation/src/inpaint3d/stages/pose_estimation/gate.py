"""What a capture must give before anything is built on it; each refusal names the figures and the repair."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import CapturedFrame
from inpaint3d.stages.pose_estimation.agreement import Agreement
from inpaint3d.stages.pose_estimation.config import Config
from inpaint3d.stages.pose_estimation.matches import PairCounts
from inpaint3d.stages.pose_estimation.suspects import Repair

DEGENERATE_SHARE = 0.7  # of the verified pairs: so many of one kind are the reason
FLAT_SHARE = 0.9  # the same where views could be placed; 39 % on photos of a papered wall
FEW_FEATURES = 100  # a median below which pictures show too little to be told apart
ENOUGH_MATCHES = 50  # of a view with others, before it is judged by them
BLANK = 4  # features below which a picture shows nothing
FAR = 10.0  # times as far from the middle camera as half of them: detail is shared out over the cube that they span
ONE_POINT = 1e-13  # of the distance from the origin: less is float64's own rounding
LEAST_EXTENT = 1e-100  # its square can still be told from 0
WALK = "walk sideways between photos, don't turn on the spot"
ESTIMATE = "set pose-estimation.cameras=estimate to find the cameras from the pictures"


class TooFewViewsError(BadInputError):
    """Too few views could be placed, though nothing says that looking harder is of no use."""


@dataclass(frozen=True)
class Evidence:
    """The figures that the gate decides on. `error_px` is at the captured size."""

    given: int
    registered: int
    unregistered: tuple[str, ...]
    model_sizes: list[int]
    pairs: PairCounts
    median_features: float
    points: int
    angle_deg: float
    error_px: float
    longest_side: int


def check_estimated(e: Evidence, config: Config) -> None:
    """BadInputError where the photos cannot carry a scene."""
    needed = max(config.min_registered, round(config.min_registered_share * e.given))
    if e.registered < needed:
        refused = BadInputError if find_degeneracy(e) else TooFewViewsError
        raise refused(_describe_too_few(e, needed))
    # With a focal length to choose, a mapper finds depth in them all the same.
    if (flat := e.pairs.turned + e.pairs.planar) >= FLAT_SHARE * e.pairs.verified > 0:
        raise BadInputError(
            f"in {flat} of {e.pairs.verified} matching pairs a turn on the spot (pure rotation) or one plane explains "
            f"all matches, so that no depth can be told; {WALK}, and have something before or behind the plane in view"
        )
    if e.angle_deg < config.min_angle_deg:
        raise BadInputError(
            f"too little parallax: the median triangulation angle is {e.angle_deg:.2f} degrees, "
            f"{config.min_angle_deg} are needed; {WALK}"
        )
    if e.points < config.min_points:
        raise BadInputError(
            f"only {e.points} points were found in {e.registered} views, {config.min_points} are needed; "
            "photograph a scene with more texture, sharper, with more overlap"
        )
    _check_error(e, config, "use sharp photos of a scene that does not move, all with one lens and zoom")


def check_known(e: Evidence, config: Config) -> None:
    """BadInputError where the pictures contradict the cameras that came with them."""
    if e.points < config.min_points and e.pairs.verified * e.pairs.median_matches > 20 * config.min_points:
        raise BadInputError(
            f"the cameras that came with the capture do not fit its pictures: {e.pairs.verified} pairs match with "
            f"{e.pairs.median_matches:.0f} inliers each, but only {e.points} points triangulate; "
            "check their conventions, or set pose-estimation.cameras=estimate"
        )
    _check_error(e, config, ESTIMATE)


def check_found(agreement: Agreement, config: Config) -> None:
    """BadInputError where many verified matches contradict the cameras that were found from them."""
    if agreement.share < config.min_agreement:
        raise BadInputError(
            f"the photos contradict each other: {agreement.share:.0%} of {agreement.verified.sum() // 2} verified "
            f"matches agree with the cameras found, {config.min_agreement:.0%} are needed; photograph a scene that "
            "does not move and does not repeat itself"
        )


def check_agreement(
    agreement: Agreement, repair: Repair | None, frames: Sequence[CapturedFrame], config: Config
) -> None:
    """BadInputError where verified matches contradict the cameras: over all views, after a usual slip, in single views.

    `repair`: a change of the cameras that brings matches clearly nearer.
    """
    side = max(max(frame.width, frame.height) for frame in frames)
    off = f"matches are usually {agreement.median_distance * side:.2f} px off"
    if np.isinf(agreement.median_distance):
        off = "most matches meet behind a camera"
    least = [v for v in np.argsort(agreement.by_view, kind="stable").tolist() if agreement.by_view[v] < agreement.share]
    where = f" (least {_shorten([f'{frames[v].name} {agreement.by_view[v]:.0%}' for v in least], 3)})" if least else ""
    slip = f"; {off}, but {repair.median_distance * side:.2f} px {repair.words}" if repair else ""
    if agreement.share < config.min_agreement or repair:
        raise BadInputError(
            f"the cameras that came with the capture contradict its pictures: {agreement.share:.0%} of "
            f"{agreement.verified.sum() // 2} verified matches agree with them{where}, "
            f"{config.min_agreement:.0%} are needed{slip}; check the cameras' order, axes and focal length, "
            f"or {ESTIMATE}"
        )
    judged = agreement.verified >= ENOUGH_MATCHES
    wrong = np.flatnonzero(judged & (agreement.by_view < config.min_view_agreement)).tolist()
    if wrong:
        told = _shorten([f"{frames[v].name} ({agreement.by_view[v]:.0%} of {agreement.verified[v]})" for v in wrong])
        raise BadInputError(
            f"the cameras of {len(wrong)} of {len(frames)} views contradict their pictures, though the others agree: "
            f"{told} of their verified matches agree; leave these views out, or {ESTIMATE}"
        )


def check_spread(centres: NDArray[np.float64], names: list[str]) -> None:
    """BadInputError where a camera [n, 3] stands so far off that the scene would shrink to a dot, or all in a point."""
    distance = np.linalg.norm(centres - np.median(centres, 0), axis=1)
    usual, away = float(np.median(distance)), float(np.abs(centres).max())
    if distance.max() <= max(ONE_POINT * away, LEAST_EXTENT):
        raise BadInputError(
            f"all {len(names)} cameras stand within {distance.max():.1g} of each other, {away:.3g} from the origin: "
            f"in one point, from which no depth can be told; check their positions, or {ESTIMATE}"
        )
    far = np.flatnonzero(distance > FAR * usual).tolist() if usual > 0 else []
    if far:
        told = _shorten([f"{names[v]} ({distance[v] / usual:.0f} times as far as most)" for v in far])
        raise BadInputError(
            f"far from all other cameras stand those of {told}; check their poses, or leave these views out"
        )


def check_blank(blank: list[str]) -> None:
    """BadInputError for pictures that show nothing, under cameras that would have them fitted."""
    if blank:
        raise BadInputError(
            f"{len(blank)} pictures show nothing that could be recognised ({_shorten(blank)}): black, or one colour; "
            "leave them out"
        )


def _check_error(e: Evidence, config: Config, repair: str) -> None:
    allowed = config.largest_error_px * e.longest_side / 1000
    if e.error_px > allowed:
        raise BadInputError(
            f"the mean reprojection error is {e.error_px:.2f} px at {e.longest_side} px wide, "
            f"{allowed:.2f} are allowed; {repair}"
        )


def find_degeneracy(e: Evidence) -> str:
    """Why no depth can be told from most pairs, in words; "" where it can."""
    for count, reason in (
        (e.pairs.still, "the pictures hardly differ: the camera rested, and what moved before it is no scene; walk on"),
        (e.pairs.turned, f"the camera only turned (pure rotation); {WALK}"),
        (e.pairs.planar, "all lies in one plane, which tells no depth; have something before or behind it in view"),
    ):
        if e.pairs.verified and count >= DEGENERATE_SHARE * e.pairs.verified:
            return f"in {count} of {e.pairs.verified} matching pairs {reason}"
    return ""


def _describe_too_few(e: Evidence, needed: int) -> str:
    counted = f"{e.registered} of {e.given} views could be placed, {needed} are needed"
    if reason := find_degeneracy(e):
        return f"{counted}: {reason}"
    if e.median_features < FEW_FEATURES:
        return (
            f"{counted}: pictures have a median of {e.median_features:.0f} features (dark, blurred, or bare surfaces); "
            "photograph a scene with more texture, sharper, in more light"
        )
    if len(e.model_sizes) > 1 and e.model_sizes[1] >= 3:
        sizes = ", ".join(map(str, e.model_sizes))
        return (
            f"{counted}: the photos fall into {len(e.model_sizes)} models that do not meet (of {sizes} views); "
            "add photos between them, or give the scenes one by one"
        )
    return (
        f"{counted}: {e.pairs.verified} of {e.given * (e.given - 1) // 2} pairs match, with a median of "
        f"{e.pairs.median_matches:.0f} inliers; take more photos that overlap by half and show one scene "
        f"(not placed: {_shorten(e.unregistered) or 'none'})"
    )


def _shorten(names: list[str] | tuple[str, ...], most: int = 5) -> str:
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")
