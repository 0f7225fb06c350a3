"""Posed views with the pretrained field's depth, as the carrying of masks needs them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import PosedCapture, RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import View, load_posed
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.map_io import read_exr

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

SURFACE_OPACITY = 0.5  # less opaque than this and the field has no surface there


@dataclass(frozen=True, eq=False)
class DepthView:
    """A view and its depth: z along the axis [h', w'], scene units, inf where the field has no surface.

    The depth map may be smaller than the picture: `depth_camera` is `camera` at the map's size.
    """

    name: str
    camera: Camera
    depth: Floats
    image: Callable[[], Image]

    @property
    def depth_camera(self) -> Camera:
        height, width = self.depth.shape
        return self.camera.resize_to(width, height)

    def depth_at(self, xy: ArrayLike) -> Floats:
        """Depth [*n] at pixels `xy` [*n, 2] of the picture (nearest; those outside get the border's)."""
        height, width = self.depth.shape
        scaled = np.asarray(xy, np.float64) * (width / self.camera.width, height / self.camera.height)
        # Points on the camera's plane have no pixel: any value will do, since callers drop them by z.
        scaled = np.clip(np.where(np.isfinite(scaled), scaled, 0.0), 0, (width - 1, height - 1))
        return self.depth[scaled[..., 1].astype(np.int64), scaled[..., 0].astype(np.int64)]

    def resized(self, width: int, height: int) -> "DepthView":
        """The same view with its picture resampled to another size; the depth map stays as it is."""

        def image() -> Image:
            return cv2.resize(self.image(), (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)

        return replace(self, camera=self.camera.resize_to(width, height), image=image)


def load_depth_views(
    posed: Artifact[PosedCapture], field: Artifact[RadianceFieldArtifact]
) -> tuple[list[View], list[DepthView]]:
    """Every posed view, and the same views with the field's depth. BadInputError where the field lacks one."""
    maps = {view.name: field.path(view.maps) for view in field.metadata.views}
    views = load_posed(posed)
    missing = [view.name for view in views if view.name not in maps]
    if missing:
        raise BadInputError(
            f"the radiance field has no depth for {len(missing)} of {len(views)} views ({', '.join(missing[:3])}); "
            "run nerf-pretraining on this posed capture"
        )
    return views, [DepthView(v.name, v.camera, read_depth(maps[v.name]), v.image) for v in views]


def read_depth(path: Path) -> Floats:
    """Depth z [h, w] from a field view's EXR; the median where it is written, since the mean blends across edges."""
    channels = read_exr(path)
    depth = channels.get("median.Z", channels.get("depth.Z"))
    if depth is None:
        raise BadInputError(f"{path} has channels {', '.join(channels)} but no depth.Z; run nerf-pretraining again")
    depth = depth.astype(np.float64)
    opacity = channels.get("opacity.A", np.ones(depth.shape, np.float32))
    return np.where((depth > 0) & (opacity >= SURFACE_OPACITY), depth, np.inf)


def order_by_nearness(apart: Floats, start: Sequence[int]) -> list[int]:
    """Views in an order that grows from those of `start` by the smallest steps, given how far apart they are [n, n]."""
    order, nearest = list(start), apart[list(start)].min(0)
    while len(order) < len(apart):
        nearest[order] = np.inf
        order.append(int(np.argmin(nearest)))
        nearest = np.minimum(nearest, apart[order[-1]])
    return order


def camera_distances(cameras: list[Camera]) -> Floats:
    """How far apart views are, [n, n]: centres' distance over their spread plus the axes' angle over a right angle."""
    centres = np.stack([c.centre for c in cameras])
    axes = np.stack([c.forward for c in cameras])
    spread = float(np.sqrt(np.mean(np.sum((centres - centres.mean(0)) ** 2, -1))))
    apart = np.linalg.norm(centres[:, None] - centres, axis=-1) / (spread if spread > 0 else 1.0)
    return apart + np.arccos(np.clip(axes @ axes.T, -1, 1)) / (np.pi / 2)
