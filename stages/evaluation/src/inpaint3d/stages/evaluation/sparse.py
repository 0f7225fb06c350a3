"""Do the surfaces of the fields lie where the poses' own points are, and is the air before them clear?"""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import Metric, Protocol
from inpaint3d.radiance.sparse_point_metrics import FRONT, measure_sparse_points
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints
from inpaint3d.stages.evaluation.bench import Bench
from inpaint3d.stages.evaluation.photos import Photo
from inpaint3d.stages.evaluation.scores import metric

SPARSE = "sparse-points"


def score_sparse_points(
    bench: Bench, cameras: list[Camera], photos: list[Photo], points: SparsePoints
) -> list[Protocol]:
    """`sparse-points`: every field against the points that held-out photos saw outside their masks.

    cameras: of all frames in order, at the size that the tracks are measured in; photos: the same frames, reduced.
    Fields may have learnt from what the training photos saw: those judge only where no photo is held out. Where a
    field's figures are not finite it is counted, and none is scored.
    """
    judges, split = choose_judges(find_known_rows(points, cameras, photos), points, photos)
    metrics: list[Metric] = []
    for method in bench.methods:
        found = measure_sparse_points(method.field, cameras, points, among=judges, block=bench.config.block)
        if found is None:
            return []
        if not np.isfinite((found.depth_error, found.floaters)).all():
            bench.non_finite[f"{method.label}/{SPARSE}"] = 1
            return []
        for name, value in (("depth_error", found.depth_error), ("floaters", found.floaters)):
            metrics.append(metric(method.label, name, value, found.points))
    count = metrics[0].views
    return [
        Protocol(
            name=SPARSE,
            description=f"{count} sightings of the points that the poses were found with, as "
            f"{split} photos saw them outside their masks. Depth: median "
            "of the relative difference between a ray's median distance and its point's. Opacity in front: what a ray "
            f"gathers in the first {FRONT:.0%} of the way, 0 in clear air.",
            metrics=tuple(metrics),
        )
    ]


def choose_judges(known: NDArray[np.bool_], points: SparsePoints, photos: list[Photo]) -> tuple[NDArray[np.bool_], str]:
    """Which known rows of the tracks are looked at, [t], and whose they are: held-out photos' if there are any."""
    held_out = known & np.array([photo.split == "test" for photo in photos])[points.track_frame]
    return (held_out, "held-out") if held_out.any() else (known, "training")


def find_known_rows(points: SparsePoints, cameras: list[Camera], photos: list[Photo]) -> NDArray[np.bool_]:
    """Which rows of the tracks lie on known pixels of their photo, [t]."""
    known = np.zeros(len(points.track_frame), bool)
    for frame, (camera, photo) in enumerate(zip(cameras, photos, strict=True)):
        rows = np.flatnonzero(points.track_frame == frame)
        height, width = photo.hole.shape
        x, y = (points.track_xy[rows] * (width / camera.width, height / camera.height)).astype(int).T
        known[rows] = photo.known[y.clip(0, height - 1), x.clip(0, width - 1)]
    return known
