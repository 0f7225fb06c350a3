"""The camera that took a photo, lens and all, beside the pinhole of its posed view."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import LensModel, PosedFrame
from inpaint3d.scene.cameras import Camera

Floats = NDArray[np.floating]
NODE = 8  # pixels between the places at which the lens is asked; between them it is as good as straight


@dataclass(frozen=True)
class Box:
    """Pixels x0 <= x < x1, y0 <= y < y1 of a photo."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def slices(self) -> tuple[slice, slice]:
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    @property
    def shape(self) -> tuple[int, int]:
        return self.y1 - self.y0, self.x1 - self.x0

    def tiles(self, side: int) -> list["Box"]:
        """Boxes of at most `side` that cover this one."""
        return [
            Box(x, y, min(x + side, self.x1), min(y + side, self.y1))
            for y in range(self.y0, self.y1, side)
            for x in range(self.x0, self.x1, side)
        ]


@dataclass(frozen=True, eq=False)
class PhotoCamera:
    """posed: the pinhole of the undistorted view. lens: COLMAP's camera at the photo's own size."""

    posed: Camera
    lens: pycolmap.Camera

    @classmethod
    def from_frame(cls, frame: PosedFrame, lens: LensModel, width: int, height: int) -> "PhotoCamera":
        own = frame.lens or lens
        model = pycolmap.CameraModelId.__members__[own.model]
        return cls(
            Camera.from_model(frame),
            pycolmap.Camera(camera_id=1, model=model, width=width, height=height, params=list(own.params)),
        )

    @cached_property
    def canvas(self) -> Camera:
        """The undistorted view at the photo's own size."""
        return self.posed.resize_to(self.lens.width, self.lens.height)

    def rays(self, box: Box, cell: int = 1) -> Floats:
        """Where the rays through the middles of square cells of `box` meet the plane z = 1 before the camera [h, w, 2].

        The box is made of whole cells.
        """
        height, width = (-(-side // cell) for side in box.shape)
        step = max(NODE // cell, 1)
        rows, columns = -(-height // step) + 2, -(-width // step) + 2
        x = box.x0 + (np.arange(columns) - 0.5) * step * cell
        y = box.y0 + (np.arange(rows) - 0.5) * step * cell
        nodes = self.unproject(np.stack(np.meshgrid(x, y), -1))
        fine = cv2.resize(nodes, (columns * step, rows * step), interpolation=cv2.INTER_LINEAR)
        return np.asarray(fine[step : step + height, step : step + width], np.float64)

    def unproject(self, xy: Floats) -> Floats:
        """Points [*n, 2] of the plane z = 1 behind pixels [*n, 2] of the photo."""
        flat = np.ascontiguousarray(xy.reshape(-1, 2), np.float64)
        return np.asarray(self.lens.cam_from_img(flat), np.float64).reshape(xy.shape)

    def to_world(self, rays: Floats, disparity: NDArray[np.floating]) -> Floats:
        """World points [*n, 3] along `rays` [*n, 2] at 1 / z = disparity [*n]."""
        in_cam = np.concatenate([rays, np.ones_like(rays[..., :1])], -1) / disparity[..., None]
        return in_cam @ self.posed.rotation.T + self.posed.centre

    def to_rays(self, points: Floats) -> tuple[Floats, Floats]:
        """Where world points [*n, 3] are seen on the plane z = 1 [*n, 2], and their z [*n]; behind it z <= 0."""
        in_cam = (points - self.posed.centre) @ self.posed.rotation
        z = in_cam[..., 2]
        return in_cam[..., :2] / np.where(z > 0, z, 1.0)[..., None], z

    def project(self, rays: Floats) -> Floats:
        """Pixels [*n, 2] of the photo in which `rays` [*n, 2] end."""
        in_cam = np.concatenate([rays, np.ones_like(rays[..., :1])], -1).reshape(-1, 3)
        return np.asarray(self.lens.img_from_cam(np.ascontiguousarray(in_cam)), np.float64).reshape(rays.shape)

    def to_posed(self, rays: Floats) -> Floats:
        """Pixels [*n, 2] of the posed view in which `rays` [*n, 2] end."""
        return rays * (self.posed.fx, self.posed.fy) + (self.posed.cx, self.posed.cy)

    def inside(self, xy: Floats) -> NDArray[np.bool_]:
        """Whether pixels [*n, 2] of the photo lie in it, so far that interpolation reads no pixel beyond."""
        margin = 1.0
        return (
            (xy[..., 0] >= margin)
            & (xy[..., 0] <= self.lens.width - margin)
            & (xy[..., 1] >= margin)
            & (xy[..., 1] <= self.lens.height - margin)
        )
