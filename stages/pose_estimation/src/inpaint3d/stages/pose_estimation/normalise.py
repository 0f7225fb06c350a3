"""The normalised world: z up, the point of interest at the origin, every camera centre within the unit ball."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.scene.geometry import Similarity, nearest_point_to_axes, rotation_about_z, rotation_between

Floats = NDArray[np.float64]

# Weight of the cameras' mean up vector against the rule that their right axes are level. Small: it decides only where
# that rule leaves a direction open (all cameras look one way).
MEAN_UP_WEIGHT = 0.005
PLANE_TRIALS = 500
PLANE_WITHIN_DEG = 20.0
PLANE_SHARE = 0.15
# Optical axes nearer to parallel than this have no reliable point where they meet.
MIN_SPREAD_DEG = 4.0
MARGIN = 1e-6


@dataclass(frozen=True)
class Normalisation:
    """How a source's world becomes the normalised one, and why."""

    normalised_from_source: Similarity
    up_evidence: str
    centre_depth: float


def normalise(poses: Floats, xyz: Floats, seed: int) -> Normalisation:
    """From poses [n, 3, 4] (world_from_cam) and points [p, 3] of the source's world."""
    up, evidence = find_up(poses, xyz, seed)
    interest, reason = find_interest(poses, xyz)
    turned = rotation_between(up, (0.0, 0.0, 1.0))
    first = turned @ (poses[0, :, 3] - interest)
    # The first camera stands at -y, so that equal captures give equal worlds whatever the source's axes were.
    if np.hypot(first[0], first[1]) > 1e-6 * np.linalg.norm(first):
        turned = rotation_about_z(-90 - np.rad2deg(np.arctan2(first[1], first[0]))) @ turned
    distances = np.linalg.norm(poses[:, :, 3] - interest, axis=1)
    if not distances.max() > 0:
        raise BadInputError("all cameras stand in one point, at what they look at; check their poses")
    scale = (1 - MARGIN) / float(distances.max())
    similarity = Similarity(scale, turned, -scale * turned @ interest)
    return Normalisation(similarity, f"{evidence}; origin: {reason}", scale * float(np.median(distances)))


def find_local_frame(centres: Floats) -> Similarity:
    """From a source's world to one around its cameras [n, 3], of about their size.

    Coordinates of a survey lie 1e6 units away from their origin: what is computed there loses six digits. The scale is
    a power of two, so that the change rounds nothing that the source has.
    """
    origin = np.median(centres, 0)
    extent = float(np.median(np.linalg.norm(centres - origin, axis=1)))
    scale = 2.0 ** -round(np.log2(extent)) if extent > 0 else 1.0
    return Similarity(scale, np.eye(3), -scale * origin)


def find_up(poses: Floats, xyz: Floats, seed: int) -> tuple[Floats, str]:
    """Unit up: across the cameras' right axes (people hold cameras level), then the big plane near that, if any."""
    right, up = poses[:, :, 0], -poses[:, :, 1]
    mean_up = up.mean(0) / np.linalg.norm(up.mean(0))
    level = right.T @ right / len(right) - MEAN_UP_WEIGHT * np.outer(mean_up, mean_up)
    across = np.linalg.eigh(level)[1][:, 0]
    across = across if across @ mean_up > 0 else -across
    tilt = np.rad2deg(np.sqrt(np.mean((right @ across) ** 2)))
    evidence = f"level of the cameras' right axes (rms tilt {tilt:.1f} deg)"
    plane = dominant_plane(poses, xyz, across, seed)
    if plane is None:
        return across, f"{evidence}; no plane across it holds {PLANE_SHARE:.0%} of the points"
    normal, share = plane
    away = np.rad2deg(np.arccos(np.clip(normal @ across, -1, 1)))
    return normal, f"plane of {share:.0%} of the points, {away:.1f} deg from the {evidence}"


def dominant_plane(poses: Floats, xyz: Floats, up: Floats, seed: int) -> tuple[Floats, float] | None:
    """Unit normal and share of points of the biggest plane within `PLANE_WITHIN_DEG` of level; None if too small.

    RANSAC with planes through three points, all cameras above; inliers lie within 2 % of the points' median spread.
    """
    if len(xyz) < 50:
        return None
    rng = np.random.default_rng(seed)
    centres = poses[:, :, 3]
    centre = np.median(xyz, 0)
    spread = np.median(np.linalg.norm(xyz - centre, axis=1))
    near = xyz[np.linalg.norm(xyz - centre, axis=1) < 3 * spread]
    thickness = 0.02 * float(spread)
    triples = near[rng.integers(0, len(near), (PLANE_TRIALS, 3))]
    normals = np.cross(triples[:, 1] - triples[:, 0], triples[:, 2] - triples[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    good = lengths > 1e-9 * spread**2
    normals = normals[good] / lengths[good, None]
    normals *= np.where(normals @ up < 0, -1.0, 1.0)[:, None]
    offsets = np.sum(normals * triples[good, 0], 1)
    below = offsets < (centres @ normals.T).min(0)
    level = below & (normals @ up > np.cos(np.deg2rad(PLANE_WITHIN_DEG)))
    if not level.any():
        return None
    normals, offsets = normals[level], offsets[level]
    counts = (np.abs(near @ normals.T - offsets) < thickness).sum(0)
    best = int(np.argmax(counts))
    inliers = near[np.abs(near @ normals[best] - offsets[best]) < thickness]
    share = len(inliers) / len(xyz)
    if share < PLANE_SHARE:
        return None
    normal = np.linalg.eigh(np.cov((inliers - inliers.mean(0)).T))[1][:, 0]
    return (normal if normal @ up > 0 else -normal), share


def find_interest(poses: Floats, xyz: Floats) -> tuple[Floats, str]:
    """What the cameras look at [3]: the point nearest to all their axes, or the middle of what they see."""
    centres, forward = poses[:, :, 3], poses[:, :, 2]
    crossing = np.linalg.eigvalsh(np.eye(3) - forward.T @ forward / len(forward))[0]
    spread = np.rad2deg(np.arcsin(np.sqrt(max(float(crossing), 0.0))))
    if spread >= MIN_SPREAD_DEG:
        point = nearest_point_to_axes(centres, forward)
        ahead = np.mean(np.sum((point - centres) * forward, 1) > 0)
        if ahead >= 0.75:
            return point, f"nearest point to all optical axes (they spread by {spread:.0f} deg)"
    depth = median_depth(poses, xyz)
    mean = forward.mean(0) / max(float(np.linalg.norm(forward.mean(0))), 1e-9)
    return centres.mean(0) + depth * mean, "on the mean optical axis at the median depth of the points"


def median_depth(poses: Floats, xyz: Floats) -> float:
    """Median depth of the points before the cameras; without points the cameras' own extent stands in."""
    z = np.einsum("nij,npi->npj", poses[:, :, 2:3], xyz[None] - poses[:, None, :, 3])[..., 0]
    if (z > 0).any():
        return float(np.median(z[z > 0]))
    return max(float(np.ptp(poses[:, :, 3], axis=0).max()), 1e-6)
