"""A plane of the scene as it looks from straight above, so that what lies on it can be copied along it.

In a photo the pattern of a floor shrinks with distance and its parallel lines meet, so that no part of it is like
another one. From above it repeats, and straight lines stay straight wherever they are copied to (Huang et al. 2014,
doi:10.1145/2601097.2601205).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.planes import Plane

Array = NDArray[np.float64]

FINENESS = 1.5
"""Cells of the grid for a pixel's side: what is resampled twice stays sharp."""
MAX_SIDE = 1024
"""Cells of the longer side of a grid, at most."""
LINE_CELLS = 41
"""Length from which on a line is one, cells."""
MIN_STRAIGHTNESS = 0.6
"""Share of the contrast along a line that points the same way, at least: across a pattern it points both ways."""
MIN_CONTRAST = 0.04
"""Change of brightness from one cell to the next, mean along a line: less is no line."""
ALL = 0.99
"""Share of an interpolated value or mean that comes from a region, from which on all does."""
GREY = np.array([0.299, 0.587, 0.114], np.float32)


@dataclass(frozen=True, eq=False)
class RectifiedPlane:
    """A grid of square cells on a plane that a camera sees.

    corner [3]: where the first cell begins; axes [2, 3]: unit vectors along the rows and down the columns; cell: side
    of a cell, scene units; shape: rows and columns.
    """

    camera: Camera
    plane: Plane
    corner: Array
    axes: Array
    cell: float
    shape: tuple[int, int]

    @classmethod
    def around(cls, camera: Camera, plane: Plane, where: Mask, gap: Mask, turn: float = 0.0) -> "RectifiedPlane":
        """The grid that holds what the pixels `where` [h, w] show of a plane, as fine as its pixels in the `gap` [h, w]
        ask; rows run to the camera's right, turned by an angle (radians).
        """
        axes = _make_axes(camera, plane, turn)
        origin = plane.offset * plane.normal
        along = (_meet(camera, plane, where) - origin) @ axes.T
        low, high = along.min(0), along.max(0)
        side = np.sqrt(_measure_area(camera, plane, gap)) / FINENESS
        cell = max(float(side), float((high - low).max()) / MAX_SIDE)
        columns, rows = np.ceil((high - low) / cell).astype(int) + 1
        return cls(camera, plane, origin + low @ axes, axes, cell, (int(rows), int(columns)))

    def find_pixels(self) -> tuple[Array, Mask]:
        """The pixel [rows, columns, 2] of the view at which each cell's middle is seen, and which lie inside it."""
        rows, columns = self.shape
        cells = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1) + np.float64(0.5)
        xy, z = self.project(cells)
        return xy, self.camera.inside(xy, z)

    def project(self, cells: Array) -> tuple[Array, Array]:
        """Pixels [*n, 2] of the view, and depth z [*n], of places (column, row) [*n, 2] on the grid, in cells."""
        return self.camera.project(self.corner + self.cell * (cells @ self.axes))

    def find_cells(self, pixels: Array) -> Array:
        """The place (column, row) [n, 2] on the grid, in cells, of pixels [n, 2] of the view that see the plane."""
        points = self.camera.unproject(pixels, self.plane.depth(self.camera, pixels))
        return (points - self.corner) @ self.axes.T / self.cell


def resample(picture: NDArray[np.generic], xy: Array) -> NDArray[np.float32]:
    """A picture [h, w, ...] at pixels [rows, columns, 2], bilinear; beyond its border the border's values."""
    x, y = (xy[..., axis].astype(np.float32) - np.float32(0.5) for axis in (0, 1))
    values = picture.astype(np.float32)
    return np.asarray(cv2.remap(values, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)


def find_line_angle(picture: Image, valid: Mask) -> float:
    """The angle (radians, within some 55 degrees of a row) that most edges of the `valid` cells run along or across.

    The fourth power of a gradient's direction as a complex number is the same for all four directions of a corner; of
    the angles around their mean the one is taken that shows most of straight lines.
    """
    gradients = np.stack([cv2.Scharr(picture @ GREY, cv2.CV_32F, *step) for step in ((1, 0), (0, 1))])
    x, y = gradients[:, _shrink(valid)]
    direction = (x + 1j * y).astype(np.complex128)
    total = (direction**4 / np.maximum(np.abs(direction), 1e-12) ** 2).sum()
    rough = np.angle(total) / 4

    def see_lines(angle: float) -> float:
        turned = _find_lines(_turn(picture, angle), _turn(valid, angle) > ALL)
        return float(sum(np.square(contrast).sum() for contrast in turned))

    angles = rough + np.radians(sorted(range(-10, 11), key=abs))
    return float(max(angles, key=see_lines))


def measure_lines_crossed(picture: Image, valid: Mask) -> NDArray[np.float32]:
    """The contrast of all straight lines between the grid's corner and each cell [h, w, 2]: along columns, along rows.

    A line counts over the whole grid: it goes on where nothing is known.
    """
    along_columns, along_rows = _find_lines(picture, valid)
    crossed = np.meshgrid(np.cumsum(along_columns.max(0)), np.cumsum(along_rows.max(1)))
    return np.stack(crossed, -1).astype(np.float32)


def _shrink(valid: Mask) -> Mask:
    """The cells [h, w] around which a gradient reads valid ones alone."""
    return cv2.erode(valid.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0


def _turn(picture: NDArray[np.generic], angle: float) -> NDArray[np.float32]:
    """A picture [h, w, ...] turned about its middle, so that what runs at an angle (radians) to a row runs along it."""
    height, width = picture.shape[:2]
    turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), float(np.degrees(angle)), 1.0)
    return np.asarray(cv2.warpAffine(picture.astype(np.float32), turn, (width, height)), np.float32)


def _find_lines(picture: Image, valid: Mask) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Contrast of the straight line along the column, and along the row, that each cell [h, w] is the middle of."""
    grey = np.asarray(picture @ GREY, np.float32)
    known = _shrink(valid).astype(np.float32)

    def measure(step: tuple[int, int], window: tuple[int, int]) -> NDArray[np.float32]:
        gradient = known * cv2.Sobel(grey, cv2.CV_32F, *step).astype(np.float32) / 8
        mean = np.abs(cv2.blur(gradient, window))
        straightness = mean / np.maximum(cv2.blur(np.abs(gradient), window), 1e-6)
        contrast = np.clip((straightness - MIN_STRAIGHTNESS) / 0.2, 0, 1) * np.maximum(mean - MIN_CONTRAST, 0)
        return np.where(cv2.blur(known, window) > ALL, contrast, 0).astype(np.float32)

    return measure((1, 0), (1, LINE_CELLS)), measure((0, 1), (LINE_CELLS, 1))


def _make_axes(camera: Camera, plane: Plane, turn: float) -> Array:
    """Unit vectors [2, 3] in the plane: to the camera's right, and towards its lower border, turned by an angle."""
    right, down = camera.rotation[:, 0], camera.rotation[:, 1]
    first = right - plane.normal * (plane.normal @ right)
    first /= np.linalg.norm(first)
    second = np.cross(plane.normal, first)
    second *= np.sign(second @ down) or 1.0
    return np.stack([np.cos(turn) * first + np.sin(turn) * second, np.cos(turn) * second - np.sin(turn) * first])


def _meet(camera: Camera, plane: Plane, where: Mask, aside: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Points [n, 3] of the plane that the pixels `where` [h, w] see, or what lies so many pixels aside of them."""
    y, x = np.nonzero(where)
    pixels = np.stack([x, y], -1) + np.float64(0.5) + aside
    return camera.unproject(pixels, plane.depth(camera, pixels))


def _measure_area(camera: Camera, plane: Plane, where: Mask) -> float:
    """Area on the plane of a pixel, scene units squared; the median of the pixels `where` [h, w]."""
    here, right, below = (_meet(camera, plane, where, aside) for aside in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    return float(np.median(np.linalg.norm(np.cross(right - here, below - here), axis=-1)))
