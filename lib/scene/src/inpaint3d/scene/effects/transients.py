"""What passes through the scene while it is photographed: somebody who walks by."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Interval
from inpaint3d.scene.effects.description import Description, Finding

if TYPE_CHECKING:
    from inpaint3d.scene.effects.evidence import Evidence

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

EFFECT = Description(
    name="transients",
    what="something that passes by while photos are taken",
    evidence="points that the views on both sides show and the one between does not, in another colour, many of them "
    "next to each other; likelihood of such clusters against stray misses, penalised (BIC)",
    off_means="every valid pixel is evidence",
    simulated_by="inpaint3d.scene.evidence_masks.IgnoredPixels",
    material=0.0,
    unit="share of the pixels",
    criterion="BIC, nats",
)
COLUMNS, ROWS = 16, 12
DIFFERENT_EV = 0.6
OCCLUDED = 0.88  # a point is hidden by what is nearer than this share of its depth
FEWEST_MISSES = 3  # in a tile
LIT = (0.03, 0.95)  # sRGB range that colours are clipped to before they are compared


def measure(evidence: "Evidence") -> Finding:
    """Share of the views' pixels in tiles where missing points cluster."""
    misses, hits = count_misses(evidence)
    if misses.sum() + hits.sum() < 200:
        return Finding("too few points lie between two views that show them to tell what passes by")
    tiles, gain = find_clusters(misses, hits)
    shares = tiles.mean((1, 2))
    value, error = float(shares.mean()), float(shares.std(ddof=1) / np.sqrt(len(shares)))
    # Of a share that is not 0 the lower end is that of the clusters that are certain: the test below is theirs.
    size = Interval(value=value, low=value if value else 0.0, high=value + 2 * error, unit=EFFECT.unit)
    figures = {"share_of_pixels": value, "views": float((shares > 0).sum()), "largest_share": float(shares.max())}
    words = (
        f"in {int((shares > 0).sum())} of {len(shares)} views points that their neighbours show are hidden in "
        f"clusters, {value:.1%} of all pixels"
    )
    confident = Interval(value=gain, low=gain, high=gain, unit="nats")
    return Finding(words, size, confident, figures, {"share": tuple(shares.round(4).tolist())})


def count_misses(evidence: "Evidence") -> tuple[Floats, Floats]:
    """Per view and tile [v, ROWS, COLUMNS]: points that should be seen and have another colour, and all others."""
    colour = np.log2(np.clip(evidence.colour, *LIT)) * 2.2 - evidence.gains
    tracked = evidence.tracked[..., None]
    count = np.maximum(tracked.sum(1), 1)
    mean = np.where(tracked & np.isfinite(colour), colour, 0.0).sum(1) / count
    away = np.abs(colour - mean[:, None]).max(-1)
    expected = evidence.expected & np.isfinite(away)
    size = np.array([(view.camera.width, view.camera.height) for view in evidence.views], np.float64)
    tile = np.floor(np.where(expected[..., None], evidence.xy, 0.0) / size * (COLUMNS, ROWS)).astype(np.int64)
    view = np.broadcast_to(np.arange(len(evidence.views)), expected.shape)
    nearest = find_nearest(evidence.depth, evidence.tracked & expected, view, tile)
    missed = expected & ~evidence.tracked & (away > DIFFERENT_EV)
    missed &= evidence.depth < nearest[view, tile[..., 1], tile[..., 0]] / OCCLUDED
    counts = np.zeros((2, len(evidence.views), ROWS, COLUMNS))
    for which, where in enumerate((missed, expected & ~missed)):
        np.add.at(counts[which], (view[where], tile[where][:, 1], tile[where][:, 0]), 1)
    return counts[0], counts[1]


def find_nearest(depth: Floats, tracked: Bools, view: NDArray[np.int64], tile: NDArray[np.int64]) -> Floats:
    """Depth of the nearest matched point of each tile and those next to it [v, ROWS, COLUMNS]; inf without one.

    What is much nearer than a missing point, and was matched, belongs to the scene and hides the point.
    """
    nearest = np.full((depth.shape[1], ROWS, COLUMNS), np.inf)
    np.minimum.at(nearest, (view[tracked], tile[tracked][:, 1], tile[tracked][:, 0]), depth[tracked])
    padded = np.pad(nearest, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    shifted = [padded[:, dy : dy + ROWS, dx : dx + COLUMNS] for dy in range(3) for dx in range(3)]
    return np.min(shifted, 0)


def find_clusters(misses: Floats, hits: Floats) -> tuple[Bools, float]:
    """Tiles [v, r, c] whose rate of misses is their own, and how much likelier that is than one rate for all.

    A tile counts where most of its points are missing, with its neighbours. The gain, nats, is penalised by half the
    logarithm of the number of points for each tile (BIC).
    """
    total = misses + hits
    common = (misses.sum() + 0.5) / (total.sum() + 1)
    own = np.clip(misses / np.maximum(total, 1), 1e-6, 1 - 1e-6)
    gain = misses * np.log(own / common) + hits * np.log((1 - own) / (1 - common))
    gain -= 0.5 * np.log(total.sum()) + np.log(total.size)  # its rate, and which tile it is
    sure = (misses >= FEWEST_MISSES) & (misses > hits) & (gain > 0)
    return _grow(sure, blocked=hits > 2 * np.maximum(misses, 0.5)), float(gain[sure].sum())


def _grow(tiles: Bools, blocked: Bools) -> Bools:
    """The tiles and those next to them, but for those where points are seen as ever."""
    padded = np.pad(tiles, ((0, 0), (1, 1), (1, 1)))
    near = np.zeros_like(tiles)
    for dy in range(3):
        for dx in range(3):
            near |= padded[:, dy : dy + tiles.shape[1], dx : dx + tiles.shape[2]]
    return tiles | (near & ~blocked)


def mask_transients(evidence: "Evidence") -> dict[str, Bools]:
    """View -> pixels [h, w] that are not evidence."""
    tiles, _ = find_clusters(*count_misses(evidence))
    return {
        view.name: _enlarge(mine, view.camera.height, view.camera.width)
        for view, mine in zip(evidence.views, tiles, strict=True)
        if mine.any()
    }


def _enlarge(tiles: Bools, height: int, width: int) -> Bools:
    rows = np.minimum(np.arange(height) * ROWS // height, ROWS - 1)
    columns = np.minimum(np.arange(width) * COLUMNS // width, COLUMNS - 1)
    return tiles[rows][:, columns]
