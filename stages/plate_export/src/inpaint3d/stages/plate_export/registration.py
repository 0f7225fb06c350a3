"""Depths refined until photos meet: a sweep over depths near the given one, as plane-sweep stereo makes it.

Collins 1996 (doi:10.1109/CVPR.1996.517097): the depth at which several photos show the same is the surface's. Around
the hole the photo itself is one of them, so that what crosses the hole's edge goes on across it.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.image_io import Mask
from inpaint3d.scene.morphology import grow
from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.photo_files import Colours
from inpaint3d.stages.plate_export.photos import Photos, sample_cubic
from inpaint3d.stages.plate_export.pieces import FromView
from inpaint3d.stages.plate_export.plan import RING, Grid, sample_own
from inpaint3d.stages.plate_export.views import PlateView

STEPS = 5
"""Depths that are tried on either side of the given one."""
STEP_PX = 0.7
"""Cells by which a step moves what the photo that moves most shows."""
MAX_SOURCES = 4
TEXTURE = 4.0
"""Cells: structure coarser than this is light, and says nothing of where a surface is."""
PATCH = 3.0
"""Cells over which differences are averaged (standard deviation)."""
SMOOTH = 6.0
"""Cells over which depths are averaged, by how surely they are told."""
DOUBT = 0.05
"""Certainty of the depth that was given."""


def refine_disparity(
    view: PlateView, photos: Photos, grid: Grid, disparity: Floats, sources: Sequence[FromView]
) -> tuple[Floats, float]:
    """1 / z [h, w] at which the sources agree with each other in the hole, and with the photo around it.

    sources: those that fill most first. Returns also the median shift in the hole, in pixels of the photo.
    """
    sources = list(sources[:MAX_SOURCES])
    around = grow(grid.hole, RING) & (grid.hole | grid.known)
    if not sources or not around.any():
        return disparity, 0.0
    rays, given = grid.rays[around], disparity[around]
    paths = [_follow(view, s, rays, given) for s in sources]
    movement = max(float(np.median(np.linalg.norm(motion, axis=-1))) for _, motion in paths) / grid.cell
    if movement < 1e-6:  # nothing moves with depth: there is nothing to be told
        return disparity, 0.0
    step = STEP_PX / movement
    own = _find_structure(sample_own(view, photos, grid), grid.known)
    usable = [
        _place(s.source.knows(s.source.camera.to_rays(view.camera.to_world(rays, given))[0]), around) for s in sources
    ]
    pictures = [(photos.reduced(s.source.name, grid.cell), s) for s in sources]
    costs = np.stack(
        [
            _compare(own, grid, around, [
                _sample(picture, s, start + offset * step * motion, around)
                for (picture, s), (start, motion) in zip(pictures, paths, strict=True)
            ], usable)
            for offset in range(-STEPS, STEPS + 1)
        ]
    )  # fmt: skip
    change, sure = _find_lowest(costs)
    weight = np.where(around, sure, 0).astype(np.float32)
    total = cv2.GaussianBlur(weight, (0, 0), SMOOTH) + DOUBT * cv2.GaussianBlur(
        around.astype(np.float32), (0, 0), SMOOTH
    )
    mean = cv2.GaussianBlur(weight * change, (0, 0), SMOOTH) / np.maximum(total, 1e-6)
    refined = disparity * (1 + np.where(around, mean * step, 0))
    shift = float(np.median(np.abs(mean[grid.hole]))) * STEP_PX * grid.cell if grid.hole.any() else 0.0
    return refined, shift


def _follow(view: PlateView, source: FromView, rays: Floats, disparity: Floats) -> tuple[Floats, Floats]:
    """Where the source has the surfaces behind rays [n, 2], pixels, and how far each moves per relative disparity."""
    small = 1e-3
    near, far = (
        source.source.camera.project(source.source.camera.to_rays(view.camera.to_world(rays, disparity * f))[0])
        for f in (1 + small, 1 - small)
    )
    return (near + far) / 2, (near - far) / (2 * small)


def _sample(picture: Colours, source: FromView, xy: Floats, around: Mask) -> Colours:
    lens = source.source.camera.lens
    scale = (picture.shape[1] / lens.width, picture.shape[0] / lens.height)
    made = np.zeros((*around.shape, picture.shape[-1]), np.float32)
    made[around] = source.colours(sample_cubic(picture, xy * scale))
    return made


def _place(flags: Mask, around: Mask) -> Mask:
    made = np.zeros_like(around)
    made[around] = flags
    return made


def _find_structure(colours: Colours, usable: Mask) -> Colours:
    """Colours without what changes slowly, 0 where not usable."""
    share = cv2.GaussianBlur(usable.astype(np.float32), (0, 0), TEXTURE)
    mean = cv2.GaussianBlur(np.where(usable[..., None], colours, np.float32(0)), (0, 0), TEXTURE).reshape(colours.shape)
    return np.where(usable[..., None], colours - mean / np.maximum(share, 1e-6)[..., None], 0).astype(np.float32)


def _compare(
    own: Colours, grid: Grid, around: Mask, sampled: Sequence[Colours], usable: Sequence[Mask]
) -> NDArray[np.float32]:
    """Mean difference of structure between the photo and each source, and among the sources; inf where none compare."""
    structures = [(_find_structure(c, u), u) for c, u in zip(sampled, usable, strict=True)]
    structures.append((own, grid.known & around))
    total, count = np.zeros(around.shape, np.float32), np.zeros(around.shape, np.float32)
    for i, (one, here) in enumerate(structures):
        for other, there in structures[i + 1 :]:
            both = here & there
            total += np.where(both, np.abs(one - other).mean(-1), 0)
            count += both
    share = cv2.GaussianBlur(count, (0, 0), PATCH)
    mean = cv2.GaussianBlur(total, (0, 0), PATCH) / np.maximum(share, 1e-6)
    return np.where(share > 1e-3, mean, np.inf).astype(np.float32)


def _find_lowest(costs: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where between -STEPS and STEPS costs [k, h, w] are lowest, by a parabola; and how sharply, 0 at the ends."""
    best = costs.argmin(0)
    inner = best.clip(1, len(costs) - 2)
    rows = np.indices(best.shape)
    low, middle, high = (costs[(inner + d, *rows)] for d in (-1, 0, 1))
    told = np.isfinite(low) & np.isfinite(middle) & np.isfinite(high) & (best == inner)
    low, middle, high = (np.where(told, c, 1) for c in (low, middle, high))
    bow = low - 2 * middle + high
    place = inner - STEPS + np.where(bow > 1e-9, (low - high) / (2 * np.maximum(bow, 1e-9)), 0)
    sharpness = np.where(told, bow / (middle + 1e-3), 0)
    return place.astype(np.float32), sharpness.astype(np.float32)
