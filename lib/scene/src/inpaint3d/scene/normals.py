"""Which way surfaces face, from how their depth changes from pixel to pixel."""

import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera


def normals_of(camera: Camera, depth: NDArray[np.floating]) -> NDArray[np.float32]:
    """Unit normals in world axes of the surface at `depth` [h, w] along the optical axis, facing the camera; [h, w, 3].

    Of a pixel's two neighbours in a row or a column the one of more similar depth counts, so that edges stay sharp.
    Zero where that one or the pixel has no finite depth, and in pictures less than two pixels wide or high.
    """
    if min(depth.shape) < 2:
        return np.zeros((*depth.shape, 3), np.float32)
    depth = np.where(np.isfinite(depth), depth, np.nan)
    points = camera.unproject(camera.pixel_centres(), depth)
    normal = np.cross(_measure_change(points, depth, axis=0), _measure_change(points, depth, axis=1))
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.divide(normal, length, out=np.zeros_like(normal), where=length > 0).astype(np.float32)


def _measure_change(points: NDArray[np.floating], depth: NDArray[np.floating], axis: int) -> NDArray[np.floating]:
    """How points [h, w, 3] change along an axis: to the next pixel or from the one before."""
    steps, jumps = np.diff(points, axis=axis), np.abs(np.diff(depth, axis=axis))
    jumps[np.isnan(jumps)] = np.inf
    before, after = ([(0, 0)] * axis + [side] for side in ((1, 0), (0, 1)))
    rest = [(0, 0)] * (1 - axis)
    to_next = np.pad(jumps, [*after, *rest], constant_values=np.inf)
    from_last = np.pad(jumps, [*before, *rest], constant_values=np.inf)
    steps_to_next, steps_from_last = (np.pad(steps, [*side, *rest, (0, 0)]) for side in (after, before))
    return np.where((to_next <= from_last)[..., None], steps_to_next, steps_from_last)
