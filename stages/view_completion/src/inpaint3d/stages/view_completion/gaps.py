"""Gaps that no photo shows, filled by example: plane by plane where surfaces are flat, else in the view itself."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts.completion import SOURCE_CODES
from inpaint3d.diffusion.fill import fill_telea
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.morphology import grow, label_parts
from inpaint3d.scene.planes import Plane
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.view_completion.config import PhotoCompletion
from inpaint3d.stages.view_completion.drafts import KNOWN_REACH, MIN_GAP, Draft
from inpaint3d.stages.view_completion.example import fill_by_example
from inpaint3d.stages.view_completion.rectified import (
    ALL,
    RectifiedPlane,
    find_line_angle,
    measure_lines_crossed,
    resample,
)

REACH = 1.8
"""Patches are copied from surfaces this much further from the middle of a gap than its own edge is, in space."""
MIN_ON_PLANE = 0.25
"""Share of a gap that lies on a plane, from which on what lies there is filled as seen from above."""
MAX_GRAZING = 0.1
"""Sine of the angle between a plane and the look at it: less, and a view shows nothing of its pattern."""
EXAMPLE, SMOOTH = SOURCE_CODES["example"], SOURCE_CODES["smooth"]


def fill_gaps(draft: Draft, method: PhotoCompletion, seed: int, device: str) -> None:
    """Close the cracks, then fill each gap from the surfaces around it."""
    cracks = draft.missing & ~grow(draft.gaps, 1)
    draft.fill(cracks, fill_telea(draft.picture, draft.missing), SMOOTH)
    points = draft.view.camera.unproject(draft.view.camera.pixel_centres(), draft.depth)
    parts, count = label_parts(draft.missing)
    for part in range(1, count + 1):
        gap = parts == part
        apart = np.linalg.norm(points - np.median(points[gap], 0), axis=-1)
        near = apart < REACH * np.quantile(apart[gap], 0.9)
        for plane, flat in _find_planes(draft, gap, points):
            _fill_on_plane(draft, plane, gap & flat & draft.missing, near & flat, method, seed, device)
        if (rest := gap & draft.missing).any():
            _fill_in_view(draft, rest, near, method, seed, device)


def _find_planes(draft: Draft, gap: Mask, points: NDArray[np.float64]) -> Iterator[tuple[Plane, Mask]]:
    """The planes that a gap lies on for the most part, and where the view shows them [h, w]. points: [h, w, 3]."""
    for plane in draft.flat.planes:
        flat = plane.distance(points) < KNOWN_REACH * draft.flat.tolerance
        towards = points[gap & flat] - draft.view.camera.centre
        if (gap & flat).sum() > MIN_ON_PLANE * gap.sum():
            sines = np.abs(towards @ plane.normal) / np.linalg.norm(towards, axis=-1)
            if np.median(sines) > MAX_GRAZING:
                yield plane, flat


def _fill_on_plane(
    draft: Draft, plane: Plane, gap: Mask, flat: Mask, method: PhotoCompletion, seed: int, device: str
) -> None:
    """Fill the `gap` of a plane from what the view knows of it in `flat`, both [h, w], as it looks from above.

    Copies keep to their side of straight lines, which go on through the gap.
    """
    camera = draft.view.camera
    source = flat & ~draft.missing & (draft.view.known | draft.view.hole)
    if not (gap.any() and source.any()):
        return
    upright = RectifiedPlane.around(camera, plane, source | gap, gap)
    turn = find_line_angle(*_look(upright, draft, source))
    rectified = RectifiedPlane.around(camera, plane, source | gap, gap, turn)
    picture, valid = _look(rectified, draft, source)
    xy, inside = rectified.find_pixels()
    blank = inside & ~valid & (resample(draft.missing, xy) > 0)
    if not blank.any():
        return
    made, origins = fill_by_example(
        picture,
        blank,
        valid,
        lines_crossed=measure_lines_crossed(picture, valid),
        variety=method.variety,
        seed=seed,
        device=device,
    )
    y, x = np.nonzero(gap)
    cells = rectified.find_cells(np.stack([x, y], -1) + np.float64(0.5))
    colours = draft.picture.copy()
    colours[y, x] = sample_bilinear(made, cells)
    if origins is not None:
        draft.note_copies(gap, _find_origins(rectified, cells, origins))
    draft.fill(gap, colours, EXAMPLE)


def _look(rectified: RectifiedPlane, draft: Draft, source: Mask) -> tuple[Image, Mask]:
    """The draft's picture from above [rows, columns, 3], and which cells show nothing but `source` [h, w]."""
    xy, inside = rectified.find_pixels()
    return resample(draft.picture, xy), inside & (resample(source, xy) > ALL)


def _find_origins(
    rectified: RectifiedPlane, cells: NDArray[np.float64], origins: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Pixels (x, y) [n, 2], counted from the first one's middle, that show what was copied to places [n, 2]."""
    rows, columns = rectified.shape
    column, row = (cells[:, axis].astype(np.int64).clip(0, n - 1) for axis, n in ((0, columns), (1, rows)))
    origin = origins[row, column]
    there = np.stack([origin % columns, origin // columns], -1) + cells - np.floor(cells)
    return rectified.project(there)[0] - 0.5


def _fill_in_view(draft: Draft, gap: Mask, near: Mask, method: PhotoCompletion, seed: int, device: str) -> None:
    """Fill a `gap` from what lies `near`, both [h, w], as the view shows it."""
    known = draft.view.known | draft.view.hole
    source = near & ~draft.missing & known
    rows, columns = (slice(max(0, a.min() - MIN_GAP), a.max() + 1 + MIN_GAP) for a in np.nonzero(gap | source))
    box = (rows, columns)
    blank = draft.missing | ~known
    colours = draft.picture.copy()
    colours[box], origins = fill_by_example(
        draft.picture[box], blank[box], source[box], variety=method.variety, seed=seed, device=device
    )
    if origins is not None:
        origin, width = origins[gap[box]], origins.shape[1]
        draft.note_copies(gap, np.stack([origin % width + columns.start, origin // width + rows.start], -1))
    draft.fill(gap, colours, EXAMPLE)
