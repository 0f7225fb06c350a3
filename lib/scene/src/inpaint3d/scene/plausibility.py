"""Whether a result can be right: limits that every good scene keeps, and what is said of one that does not.

A capture whose cameras are wrong still gives a field, masks and pictures; their own figures tell. On good captures
(phone photos, a turntable, a rendered room) held-out views score 20 to 26 dB, depth is off by less than 1 % and
floaters are below 2 %; with the cameras of a real capture in the wrong order these were 13.9 dB, 37 % and 49 %.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints, View
from inpaint3d.scene.psnr import mean_psnr, psnr
from inpaint3d.scene.reprojection import correspondences, sample_bilinear

MEAN_COLOUR, WARPED = "the mean colour of the photos", "the nearest photo, warped"
# Photos that stand close together are warped into each other as well as a field of few steps shows them.
LEAST_GAIN_DB = {MEAN_COLOUR: 1.0, WARPED: -3.0}
LARGEST_DEPTH_ERROR = 0.1
LARGEST_FLOATERS = 0.25
LARGEST_HOLE = 0.7  # of the views' pixels, where not everything beyond the hole is to be made up
LEAST_CONSISTENCY = 0.25
LEAST_COMPLETION_DB = 18.0  # between neighbours; 31 on the demo capture, 17 with its completed views shuffled
FEWEST_PIXELS = 20
LATTICE = 48  # longest side of what baselines are measured on
POINTS = 2000  # of those that a view's coarse depth is made of

TRY = "look at the views under runs/NAME, check the capture's cameras (pose-estimation.cameras=estimate), or fit longer"


def doubt_field(
    held_out_psnr: float | None, baselines: dict[str, float], depth_error: float | None, floaters: float | None
) -> list[str]:
    """What speaks against a field: its own figures, and `baselines` as of `measure_baselines`."""
    doubts: list[str] = []
    for name, reached in baselines.items():
        if held_out_psnr is not None and held_out_psnr < reached + LEAST_GAIN_DB[name]:
            doubts.append(
                f"views held out score {held_out_psnr:.1f} dB, {name} {reached:.1f} dB: at least "
                f"{reached + LEAST_GAIN_DB[name]:.1f} dB are to be had"
            )
    if depth_error is not None and depth_error > LARGEST_DEPTH_ERROR:
        doubts.append(
            f"depth is off by {depth_error:.0%} at the sparse points (more than {LARGEST_DEPTH_ERROR:.0%} cannot be "
            "right)"
        )
    if floaters is not None and floaters > LARGEST_FLOATERS:
        doubts.append(
            f"{floaters:.0%} of the light to the sparse points is lost before them (floaters; more than "
            f"{LARGEST_FLOATERS:.0%} cannot be right)"
        )
    return [f"{'; '.join(doubts)}: {TRY}"] if doubts else []


def doubt_masks(share: float, consistency: float | None, *, outside: bool) -> list[str]:
    """What speaks against masks: the share of the views' pixels that they cover, and how far neighbours agree.

    outside: all but a part of the scene is to be made up.
    """
    doubts: list[str] = []
    if share > LARGEST_HOLE and not outside:
        doubts.append(
            f"masks cover {share:.0%} of the pictures (more than {LARGEST_HOLE:.0%} leaves too little to tell)"
        )
    if consistency is not None and consistency < LEAST_CONSISTENCY:
        doubts.append(
            f"masks of neighbouring views agree by {consistency:.2f} (IoU; below {LEAST_CONSISTENCY} they outline "
            "different things)"
        )
    return [f"{'; '.join(doubts)}: look at them, and give other points or a box in the mask request"] if doubts else []


class CompletedHole(NamedTuple):
    """A completed view at its depth map's size: picture [h, w, 3], depth z and hole [h, w]."""

    camera: Camera
    picture: NDArray[np.float32]
    depth: NDArray[np.float32]
    hole: NDArray[np.bool_]

    @classmethod
    def of(cls, camera: Camera, picture: ArrayLike, depth: NDArray[np.float32], hole: ArrayLike) -> "CompletedHole":
        """Of a picture and hole at the view's own size."""
        size = depth.shape[1], depth.shape[0]
        small = cv2.resize(np.asarray(picture, np.float32), size, interpolation=cv2.INTER_AREA)
        inside = cv2.resize(np.asarray(hole, np.float32), size, interpolation=cv2.INTER_AREA) > 0.5
        return cls(camera.resize_to(*size), np.asarray(small, np.float32), depth, inside)


def doubt_completion(psnr: float | None) -> list[str]:
    """What speaks against completed views: how far neighbours agree about what fills the hole, dB."""
    if psnr is None or psnr >= LEAST_COMPLETION_DB:
        return []
    return [
        f"what fills the hole differs from view to view: {psnr:.1f} dB between neighbours (below "
        f"{LEAST_COMPLETION_DB:g} dB it is no one thing): {TRY}"
    ]


def measure_completions(views: Sequence[CompletedHole]) -> float | None:
    """Mean PSNR in dB of each hole against the nearest view's picture, carried over by depth; None where none meet."""
    scores: list[float] = []
    for view in views:
        others = [other for other in views if other is not view]
        if not others:
            break
        near = min(others, key=lambda other: float(np.linalg.norm(other.camera.centre - view.camera.centre)))
        xy, seen = correspondences(view.camera, view.depth, near.camera, near.depth, tolerance=0.05)
        seen &= view.hole
        if seen.sum() >= FEWEST_PIXELS:
            scores.append(psnr(sample_bilinear(near.picture, xy[seen]), view.picture[seen]))
    return mean_psnr(scores)


def measure_baselines(train: Sequence[View], test: Sequence[View], points: SparsePoints) -> dict[str, float]:
    """PSNR in dB on test views, mean over them, of answers that need no field; {} without test or training views."""
    if not train or not test:
        return {}
    mean = np.mean([view.image()[::8, ::8].reshape(-1, 3).mean(0) for view in train], 0)
    colours = [_sample_lattice(view)[0] for view in test]
    flat = mean_psnr(psnr(np.broadcast_to(mean, truth.shape), truth) for truth in colours)
    warped = mean_psnr(score for view in test if (score := _warp_nearest(view, train, points)) is not None)
    return {name: score for name, score in ((MEAN_COLOUR, flat), (WARPED, warped)) if score is not None}


def _sample_lattice(view: View) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Colours [h, w, 3] of every so many pixels of a view, and these pixels' centres [h, w, 2]."""
    step = max(1, -(-max(view.camera.width, view.camera.height) // LATTICE))
    lattice = np.s_[step // 2 :: step, step // 2 :: step]
    return view.image()[lattice], view.camera.pixel_centres()[lattice]


def _warp_nearest(view: View, others: Sequence[View], points: SparsePoints) -> float | None:
    """PSNR of the nearest other photo, seen by the depth of the sparse points next to each pixel."""
    xyz = points.xyz[:: max(1, -(-len(points.xyz) // POINTS))]
    xy, z = view.camera.project(xyz)
    inside = view.camera.inside(xy, z)
    if not inside.any():
        return None
    nearest = min(others, key=lambda other: float(np.linalg.norm(other.camera.centre - view.camera.centre)))
    colours, pixels = _sample_lattice(view)
    apart = np.linalg.norm(pixels[..., None, :] - xy[inside].astype(np.float32), axis=-1)
    depth = z[inside][np.argmin(apart, -1)]
    where, ahead = nearest.camera.project(view.camera.unproject(pixels, depth))
    seen = nearest.camera.inside(where, ahead)
    return psnr(sample_bilinear(nearest.image(), where[seen]), colours[seen]) if seen.any() else None
