"""One photo's codes as another one's: gain and offset of each channel; and completion's sRGB as a photo's codes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.colour import linear_from_srgb
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.photo_files import Colours
from inpaint3d.stages.plate_export.photos import Photos
from inpaint3d.stages.plate_export.views import PlateView

MIN_PAIRS = 60
"""Pairs of colours from which on a gain is told."""
SAMPLES = 6000
"""Pixels of a view that are compared at most."""
TRIMMED = 2.5
"""Median deviations beyond which a pair is something else."""
LARGEST_GAIN = 4.0


@dataclass(frozen=True, eq=False)
class ColourMap:
    """target = matrix @ given + offset: [c, k], [c]."""

    matrix: NDArray[np.float32]
    offset: NDArray[np.float32]

    def __call__(self, given: Colours) -> Colours:
        return given @ self.matrix.T + self.offset


def match_photos(target: PlateView, source: PlateView, photos: Photos) -> ColourMap:
    """Gain and offset of each channel that bring source's codes to target's, from surfaces that both know.

    No offset where files hold light. The identity where they share too little, or are of different kinds.
    """
    channels = photos.file(target.name).colours
    same = ColourMap(np.eye(channels, dtype=np.float32), np.zeros(channels, np.float32))
    rays = known_rays(target)
    points = target.camera.to_world(rays, target.disparity_at(rays))
    there, z = source.camera.to_rays(points)
    shared = (z > 0) & source.knows(there) & source.sees(there, z)
    if shared.sum() < MIN_PAIRS:
        return same
    mine = sample_small(target, photos, rays[shared])
    theirs = sample_small(source, photos, there[shared])
    fits = [_fit_line(theirs[:, c], mine[:, c], offset=not photos.file(target.name).linear) for c in range(channels)]
    return ColourMap(np.diag([f[0] for f in fits]).astype(np.float32), np.array([f[1] for f in fits], np.float32))


def match_completed(view: PlateView, photos: Photos) -> ColourMap:
    """What brings completion's sRGB colours (as `prepare_completed` has them) to the photo's codes."""
    rays = known_rays(view)
    codes = sample_small(view, photos, rays)
    given = prepare_completed(sample_bilinear(view.picture, view.camera.to_posed(rays)), photos, view)
    start = np.eye(3, dtype=np.float32) if codes.shape[1] == 3 else np.full((1, 3), 1 / 3, np.float32)
    if len(rays) < MIN_PAIRS:
        return ColourMap(start, np.zeros(codes.shape[1], np.float32))
    # Ridge towards the identity: a grey scene says nothing of what colours would become.
    design = np.concatenate([given, np.ones((len(given), 1), np.float32)], 1).astype(np.float64)
    prior = np.concatenate([start.T, np.zeros((1, codes.shape[1]))])
    weight = 1e-3 * len(given) * np.diag([1.0, 1.0, 1.0, 1e-3])
    solution = np.linalg.solve(design.T @ design + weight, design.T @ codes + weight @ prior)
    return ColourMap(solution[:3].T.astype(np.float32), solution[3].astype(np.float32))


def prepare_completed(srgb: Colours, photos: Photos, view: PlateView) -> Colours:
    """Completion's colours [*n, 3] as light where the photo's file holds light."""
    return linear_from_srgb(srgb).astype(np.float32) if photos.file(view.name).linear else srgb


def known_rays(view: PlateView) -> Floats:
    """Rays [n, 2] through known pixels of the posed view, spread evenly, at most `SAMPLES`."""
    y, x = np.nonzero(view.known)
    step = max(1, len(y) // SAMPLES)
    xy = np.stack([x[::step] + 0.5, y[::step] + 0.5], -1)
    camera = view.camera.posed
    rays = (xy - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    return rays[view.camera.inside(view.camera.project(rays))]


def sample_small(view: PlateView, photos: Photos, rays: Floats) -> Colours:
    """The photo's colours [n, c] behind rays [n, 2], of averages about as wide as a pixel of the posed view."""
    cell = max(1, round(view.camera.lens.width / view.camera.posed.width))
    small = photos.reduced(view.name, cell)
    scale = (small.shape[1] / view.camera.lens.width, small.shape[0] / view.camera.lens.height)
    return sample_bilinear(small, view.camera.project(rays) * scale)


def _fit_line(given: Colours, wanted: Colours, *, offset: bool) -> tuple[float, float]:
    """Slope and offset by least squares, twice without the pairs that are far off."""
    x, y = given.astype(np.float64), wanted.astype(np.float64)
    kept = np.ones(len(x), bool)
    slope, shift = 1.0, 0.0
    for _ in range(3):
        a, b = x[kept], y[kept]
        if offset:
            spread = ((a - a.mean()) ** 2).sum() + 1e-3 * len(a)
            # A little ridge: flat colours tell an offset, and no slope.
            slope = (((a - a.mean()) * (b - b.mean())).sum() + 1e-3 * len(a)) / spread
            shift = b.mean() - slope * a.mean()
        else:
            slope = (a * b).sum() / max((a * a).sum(), 1e-12)
        off = np.abs(y - slope * x - shift)
        kept = off <= max(TRIMMED * float(np.median(off)), 1e-6)
    return float(np.clip(slope, 1 / LARGEST_GAIN, LARGEST_GAIN)), float(shift)
