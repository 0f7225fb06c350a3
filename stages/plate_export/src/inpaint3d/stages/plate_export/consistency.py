"""How alike neighbouring plates are: one seen from the other by depth, in the hole and beside it."""

from collections.abc import Mapping, Sequence

import numpy as np

from inpaint3d.contracts.models.artifacts import PlateConsistency
from inpaint3d.scene.cameras import measure_apart
from inpaint3d.scene.morphology import grow
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.plate_export.colours import match_photos
from inpaint3d.stages.plate_export.lens import Floats
from inpaint3d.stages.plate_export.photo_files import Colours
from inpaint3d.stages.plate_export.photos import Photos
from inpaint3d.stages.plate_export.views import PlateView

REACH = 0.5
"""Known pixels count up to so far from the hole, as a share of its own size."""


def measure_consistency(
    views: Sequence[PlateView], photos: Photos, small: Mapping[str, Colours]
) -> PlateConsistency | None:
    """Each view's plate against that of the view nearest to it. small: by name the plate at about the posed size."""
    sums, counts, pairs = np.zeros(2), np.zeros(2, np.int64), 0
    for view in views:
        rivals = [v for v in views if v is not view and small[v.name].shape[-1] == small[view.name].shape[-1]]
        if not rivals or not view.hole.any():
            continue
        nearest = min(rivals, key=lambda v: measure_apart(view.camera.posed, v.camera.posed))
        found = _compare(view, nearest, photos, small)
        sums += found[0]
        counts += found[1]
        pairs += 1
    if not counts.all():
        return None
    hole, known = sums / counts
    return PlateConsistency(
        hole=round(float(hole), 6),
        known=round(float(known), 6),
        ratio=round(float(hole / max(known, 1e-9)), 4),
        pairs=pairs,
    )


def _compare(
    view: PlateView, other: PlateView, photos: Photos, small: Mapping[str, Colours]
) -> tuple[Floats, np.ndarray]:
    """Sums of absolute differences in the hole and beside it, and of how many pixels."""
    near = grow(view.hole, max(2, int(REACH * np.sqrt(view.hole.sum()))))
    y, x = np.nonzero(near)
    camera = view.camera.posed
    rays = (np.stack([x + 0.5, y + 0.5], -1) - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    there, z = other.camera.to_rays(view.camera.to_world(rays, view.disparity_at(rays)))
    shared = (z > 0) & other.sees(there, z)
    shared &= view.camera.inside(view.camera.project(rays)) & other.camera.inside(other.camera.project(there))
    mine, theirs = _sample_at(view, small, rays), match_photos(view, other, photos)(_sample_at(other, small, there))
    apart = np.abs(mine - theirs).mean(-1)
    hole = view.hole[y, x] & shared
    known = view.knows(rays) & other.knows(there) & shared
    return np.array([apart[hole].sum(), apart[known].sum()]), np.array([hole.sum(), known.sum()])


def _sample_at(view: PlateView, small: Mapping[str, Colours], rays: Floats) -> Colours:
    picture = small[view.name]
    scale = (picture.shape[1] / view.camera.lens.width, picture.shape[0] / view.camera.lens.height)
    return sample_bilinear(picture, view.camera.project(rays) * scale)
