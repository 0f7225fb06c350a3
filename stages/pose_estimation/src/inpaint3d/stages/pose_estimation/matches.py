"""Matches of two pictures that one two-view geometry explains, and what kinds of geometries these are."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Kind = pycolmap.TwoViewGeometryConfiguration

TURNED = (Kind.PANORAMIC, Kind.PLANAR_OR_PANORAMIC)
STILL = 0.002  # of the longest side: matches that move less show what moves with the camera, or a camera that rests


@dataclass(frozen=True, eq=False)
class VerifiedPair:
    """Matches [m, 2] of two pictures (by view) that one two-view geometry explains, captured pixels."""

    first: int
    second: int
    first_xy: Floats
    second_xy: Floats
    kind: pycolmap.TwoViewGeometryConfiguration

    def __len__(self) -> int:
        return len(self.first_xy)

    @property
    def shift(self) -> float:
        """Median distance between matching pixels."""
        return float(np.median(np.linalg.norm(self.first_xy - self.second_xy, axis=1)))


@dataclass(frozen=True)
class PairCounts:
    """Verified pairs of a capture, and those among them from which no depth can be told."""

    verified: int
    turned: int
    planar: int
    still: int
    median_matches: float


def read_verified_pairs(database: Path, names: Sequence[str]) -> list[VerifiedPair]:
    """The verified matches between the named pictures, in the order of the database."""
    view_of = {name: view for view, name in enumerate(names)}
    with pycolmap.Database.open(database) as db:
        views = {image.image_id: view_of[image.name] for image in db.read_all_images() if image.name in view_of}
        xy = {number: db.read_keypoints(number)[:, :2].astype(np.float64) for number in views}
        numbers, geometries = db.read_two_view_geometries()
    pairs: list[VerifiedPair] = []
    for number, geometry in zip(numbers, geometries, strict=True):
        a, b = pycolmap.pair_id_to_image_pair(number)
        rows = np.asarray(geometry.inlier_matches, np.int64)
        if a in views and b in views and len(rows):
            pairs.append(VerifiedPair(views[a], views[b], xy[a][rows[:, 0]], xy[b][rows[:, 1]], Kind(geometry.config)))
    return pairs


def count_kinds(pairs: Sequence[VerifiedPair], longest_side: int) -> PairCounts:
    """How many pairs a turn on the spot, a plane, or a camera at rest explains. `longest_side`: of the pictures."""
    return PairCounts(
        verified=len(pairs),
        turned=sum(pair.kind in TURNED for pair in pairs),
        planar=sum(pair.kind == Kind.PLANAR for pair in pairs),
        still=sum(pair.shift < STILL * longest_side for pair in pairs),
        median_matches=float(np.median([len(pair) for pair in pairs])) if pairs else 0.0,
    )
