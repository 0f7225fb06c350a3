"""Scenes that reach so far that a box round them would waste its cells on the background."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.effects.description import Description, Finding
from inpaint3d.scene.effects.intervals import GROUPS, jackknife, mean_of_folds, split_groups

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

Floats = NDArray[np.float64]

EFFECT = Description(
    name="contraction",
    what="a scene without an end: a far background behind what the cameras go round",
    evidence="how much finer than a box's the contracted grid's cells are where the sparse points lie, the points' "
    "distances against the cameras'; a box made for some points asked of the others",
    off_means="a plain box, exact coordinates",
    simulated_by="inpaint3d.radiance.contraction.contract",
    # A box has to be finer by a quarter of a bit before it is the better one: in benchmarks/effects a room whose walls
    # stand half as far again, where both are alike, shows held-out views better contracted.
    material=-0.25,
    least_gain=-0.25,
    unit="bits of resolution a point",
    criterion="held-out points",
)
FEWEST_POINTS = 20
FAR = 2.5  # scene units; cameras lie within 1
# Without contraction the cube is just large enough for this percentage of the sparse points (outliers would make it far
# too large), times the margin.
POINTS_INSIDE, CUBE_MARGIN = 99.0, 1.1
# Where these reach this many times as far as all but 3 %, the cube leaves them out: a bounded scene may have a few
# points that are far away.
CORE_INSIDE, FAR_BEYOND = 97.0, 2.0
OUTSIDE_BITS = 10.0  # what lies beyond the box is not there at all: as if its cells were 2^10 times too large


def measure(evidence: "Evidence") -> Finding:
    """Bits of resolution that contraction gains at the points, mean over them; negative in a room."""
    xyz = evidence.points.xyz.astype(np.float64)
    if len(xyz) < FEWEST_POINTS:
        return Finding(f"only {len(xyz)} sparse points tell how far the scene reaches", unknown=True)
    size = jackknife(lambda kept: gained_bits(xyz[kept], cube_half_side(xyz[kept])).mean(), len(xyz), EFFECT.unit)
    group = split_groups(len(xyz))
    folds = [gained_bits(xyz[group == g], cube_half_side(xyz[group != g])).mean() for g in range(GROUPS)]
    gain = mean_of_folds(np.array(folds), EFFECT.unit)
    radius = np.linalg.norm(xyz, axis=-1)
    figures = {
        "gained_bits": size.value,
        "share_beyond_far_radius": float((radius > FAR).mean()),
        "share_outside_unit_ball": float((radius > 1).mean()),
        "radius_of_99_percent": float(np.quantile(radius, 0.99)),
        "tiles_without_points": share_without_points(evidence),
    }
    words = (
        f"{figures['share_beyond_far_radius']:.1%} of the sparse points lie further than {FAR:g} scene units from the "
        f"point of interest; a contracted grid's cells are {abs(size.value):.2f} bits "
        f"{'finer' if size.value > 0 else 'coarser'} at the points than a box's"
    )
    return Finding(words, size, gain, figures)


def gained_bits(xyz: Floats, half_side: float) -> Floats:
    """log2 of a box's cell over a contracted grid's, both of equally many cells a side, at points [n, 3]; [n].

    The box has the side 2 half_side, contracted space the side 4; contraction shrinks what lies at distance r > 1 by
    (2 - 1/r) / r across, and by 1/r^2 along the ray, which matters least: views tell little of it.
    """
    radius = np.maximum(np.linalg.norm(xyz, axis=-1), 1.0)
    contracted = 4 * radius / (2 - 1 / radius)
    bits = np.log2(2 * half_side / contracted)
    return np.where(np.abs(xyz).max(-1) > half_side, OUTSIDE_BITS, bits)


def cube_half_side(points: NDArray[np.floating]) -> float:
    """Half side, in scene units, of the cube round the origin that holds the cameras and the sparse points [p, 3].

    What few points lie far beyond all others does not count: the cells would be spent on the space between.
    """
    if not len(points):
        return CUBE_MARGIN
    reach, core = np.percentile(np.abs(points).max(-1), (POINTS_INSIDE, CORE_INSIDE))
    return CUBE_MARGIN * max(1.0, float(core if reach > FAR_BEYOND * core else reach))


def share_without_points(evidence: "Evidence", columns: int = 8, rows: int = 6) -> float:
    """Share of the views' tiles that no point falls into: the sky, or a wall without texture."""
    size = np.array([(view.camera.width, view.camera.height) for view in evidence.views], np.float64)
    seen = np.isfinite(evidence.xy[..., 0])
    tile = np.floor(np.where(seen[..., None], evidence.xy, 0.0) / size * (columns, rows)).astype(np.int64)
    view = np.broadcast_to(np.arange(len(evidence.views)), seen.shape)
    taken = np.unique(((view * rows + tile[..., 1]) * columns + tile[..., 0])[seen])
    return float(1 - len(taken) / max(1, rows * columns * len(evidence.views)))
