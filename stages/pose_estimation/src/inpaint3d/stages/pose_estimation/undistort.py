"""Pinhole pictures without the lens: the same focal lengths and centre, at the output size."""

from functools import cached_property

import cv2
import numpy as np
import pycolmap
from numpy.typing import ArrayLike, NDArray

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image, Mask

Floats = NDArray[np.float64]


class Undistorter:
    """Takes one lens's captured pictures and pixels to a pinhole of at most `longest_side` (never enlarged)."""

    def __init__(self, lens: pycolmap.Camera, longest_side: int) -> None:
        self.lens = lens
        shrink = min(1.0, longest_side / max(lens.width, lens.height))
        self.width, self.height = (max(1, round(v * shrink)) for v in (lens.width, lens.height))
        self._full = Camera(
            lens.focal_length_x, lens.focal_length_y, lens.principal_point_x, lens.principal_point_y,
            lens.width, lens.height, np.eye(4),
        )  # fmt: skip

    def camera(self, world_from_cam: ArrayLike) -> Camera:
        """The pinhole camera of an undistorted view at a pose."""
        small = self._full.resize_to(self.width, self.height)
        return Camera(small.fx, small.fy, small.cx, small.cy, small.width, small.height, np.asarray(world_from_cam))

    def image(self, captured: Image) -> Image:
        """A captured picture [h, w, 3], undistorted at its own size, then reduced by area averages."""
        straight = captured
        if self._bends:
            x, y = self._maps
            straight = np.asarray(
                cv2.remap(captured, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32
            )
        return np.asarray(self._reduce(straight), np.float32)

    def mask(self, captured: Mask) -> Mask:
        """A captured mask, undistorted and reduced by the nearest pixel."""
        camera = self._full.resize_to(self.width, self.height)
        at = np.floor(self._distort(camera, camera.pixel_centres())).astype(np.int64)
        at = at.reshape(self.height, self.width, 2)
        return captured[np.clip(at[..., 1], 0, self.lens.height - 1), np.clip(at[..., 0], 0, self.lens.width - 1)]

    @cached_property
    def valid(self) -> Mask | None:
        """Pixels that come wholly from the captured picture; None: all of them."""
        if not self._bends:
            return None
        x, y = self._maps
        held = (x >= -0.5) & (x <= self.lens.width - 0.5) & (y >= -0.5) & (y <= self.lens.height - 0.5)
        whole = self._reduce(held.astype(np.float32)) > 1 - 1e-6
        return None if whole.all() else whole

    def combine_valid(self, opaque: Mask | None) -> Mask | None:
        """Pixels that come wholly from what a captured picture shows, `opaque` [h, w] (None: everywhere); None: all."""
        if opaque is None or opaque.all():
            return self.valid
        covered = self.image(np.repeat(opaque[..., None], 3, -1).astype(np.float32))[..., 0] > 1 - 1e-6
        return covered if self.valid is None else covered & self.valid

    def pixels(self, captured_xy: ArrayLike) -> Floats:
        """Captured pixels [n, 2] as pixels of the undistorted view."""
        captured_xy = np.ascontiguousarray(captured_xy, np.float64).reshape(-1, 2)
        small = self._full.resize_to(self.width, self.height)
        return np.asarray(self.lens.cam_from_img(captured_xy)) * (small.fx, small.fy) + (small.cx, small.cy)

    @property
    def _bends(self) -> bool:
        extra = list(self.lens.extra_params_idxs())
        # A fisheye bends without a parameter: its radius goes with the angle, not with its tangent.
        fisheye = self.lens.model_name.endswith("FISHEYE")
        return fisheye or bool(np.any(np.asarray(self.lens.params)[extra] != 0))

    @cached_property
    def _maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Where full-size pinhole pixels are in the captured picture, in OpenCV's indices (whole at centres)."""
        xy = self._distort(self._full, self._full.pixel_centres()) - 0.5
        maps = xy.astype(np.float32).reshape(self.lens.height, self.lens.width, 2)
        return np.ascontiguousarray(maps[..., 0]), np.ascontiguousarray(maps[..., 1])

    def _distort(self, pinhole: Camera, xy: Floats) -> Floats:
        """Pinhole pixels [*n, 2] as captured pixels [n, 2]."""
        plane = (xy.reshape(-1, 2) - (pinhole.cx, pinhole.cy)) / (pinhole.fx, pinhole.fy)
        return np.asarray(self.lens.img_from_cam(np.concatenate([plane, np.ones((len(plane), 1))], 1)))

    def _reduce(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        if (self.width, self.height) == (self.lens.width, self.lens.height):
            return picture
        return np.asarray(cv2.resize(picture, (self.width, self.height), interpolation=cv2.INTER_AREA), np.float32)
