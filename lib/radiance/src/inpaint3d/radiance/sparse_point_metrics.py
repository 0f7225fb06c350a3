"""How well a field's surfaces agree with the sparse points that the poses came from."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.line_of_sight import SightLines, opacity_before
from inpaint3d.radiance.rendering import render
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints

# The camera saw the point, so nothing lies before it: density on this share of the way is fog, not a surface. The rest
# of the way belongs to the surface that the point lies on.
FRONT = 0.9
MAX_SIGHT_LINES = 4096


class SparsePointMetrics(NamedTuple):
    """At points as the cameras saw them; `points` counts those looked at."""

    depth_error: float
    """Median of |distance - point's distance| over the point's distance; the distance is the median along the ray."""
    floaters: float
    """Mean opacity gathered in front of nine tenths of the way to the point; 0 in clear air."""
    points: int


@torch.no_grad()
def measure_sparse_points(
    field: RadianceField,
    cameras: Sequence[Camera],
    points: SparsePoints,
    *,
    among: NDArray[np.bool_] | None = None,
    block: int = 4096,
) -> SparsePointMetrics | None:
    """Look from the cameras at the points that they saw (at most 4096 sightings, evenly chosen); None without any.

    `points.track_frame` indexes `cameras`. among: which rows of the tracks to look at, if not at all, bool [t].
    """
    sightings = np.arange(len(points.track_frame)) if among is None else np.flatnonzero(among)
    if not len(sightings):
        return None
    chosen = sightings[np.unique(np.linspace(0, len(sightings) - 1, MAX_SIGHT_LINES).round().astype(int))]
    sighted = SightLines.of(cameras, points, chosen, field.device)
    found, in_front = [], []
    for start in range(0, len(chosen), block):
        part = slice(start, start + block)
        seen = render(field, sighted.rays[part])
        found.append(seen.median_depth)
        in_front.append(opacity_before(seen.weights, seen.tdist, FRONT * sighted.distance[part]))
    error = (torch.cat(found) - sighted.distance).abs() / sighted.distance
    return SparsePointMetrics(float(error.quantile(0.5)), float(torch.cat(in_front).mean()), len(chosen))
