"""Rays of pixels, in torch."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int64
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.scene.cameras import Camera


@dataclass(frozen=True)
class Rays:
    """Rays in the world: origins in scene units, unit directions, and the view whose appearance code they take."""

    origins: Float[Tensor, "*n 3"]
    directions: Float[Tensor, "*n 3"]
    view: Int64[Tensor, "*n"] | None = None

    @property
    def shape(self) -> torch.Size:
        return self.origins.shape[:-1]

    def flatten(self) -> "Rays":
        view = None if self.view is None else self.view.reshape(-1)
        return Rays(self.origins.reshape(-1, 3), self.directions.reshape(-1, 3), view)

    def __getitem__(self, index: slice) -> "Rays":
        view = None if self.view is None else self.view[index]
        return Rays(self.origins[index], self.directions[index], view)


def join_rays(parts: Sequence[Rays]) -> Rays:
    """Rays [n] of several draws as one; the view is kept where every part has one."""
    views = [p.view for p in parts if p.view is not None]
    view = torch.cat(views) if len(views) == len(parts) else None
    return Rays(torch.cat([p.origins for p in parts]), torch.cat([p.directions for p in parts]), view)


@dataclass(frozen=True)
class CameraStack:
    """Several cameras as tensors, so that rays of pixels of different views come in one go."""

    pinhole: Float[Tensor, "v 4"]  # fx, fy, cx, cy in pixels
    world_from_cam: Float[Tensor, "v 3 4"]

    @classmethod
    def of(cls, cameras: Sequence[Camera], device: torch.device | str = "cpu") -> "CameraStack":
        pinhole = torch.tensor([[c.fx, c.fy, c.cx, c.cy] for c in cameras], dtype=torch.float32)
        poses = torch.from_numpy(np.stack([c.world_from_cam for c in cameras])).float()
        return cls(pinhole.to(device), poses.to(device))

    def rays(self, view: Int64[Tensor, " n"], xy: Float[Tensor, "n 2"]) -> Rays:
        """Rays through positions xy (pixels, the first pixel's centre at 0.5) of the cameras `view`."""
        pinhole, pose = self.pinhole[view], self.world_from_cam[view]
        plane = (xy - pinhole[:, 2:]) / pinhole[:, :2]
        in_cam = torch.cat([plane, torch.ones_like(plane[:, :1])], -1)
        directions = torch.einsum("nij,nj->ni", pose[:, :, :3], in_cam)
        directions = directions / torch.linalg.vector_norm(directions, dim=-1, keepdim=True)
        return Rays(pose[:, :, 3], directions, view)


def camera_rays(
    camera: Camera,
    xy: Float[Tensor, "*n 2"] | NDArray[np.floating] | None = None,
    *,
    view: int | None = None,
    device: torch.device | str = "cpu",
) -> Rays:
    """Rays through pixel positions xy of a camera; of all its pixel centres, [h, w], where that is None.

    `view` is the index of the appearance code; None takes the mean code.
    """
    origins, directions = camera.rays(xy.cpu().numpy() if isinstance(xy, Tensor) else xy)
    codes = None if view is None else torch.full(directions.shape[:-1], view, dtype=torch.int64, device=device)
    return Rays(
        torch.from_numpy(np.array(origins)).to(device, torch.float32),
        torch.from_numpy(directions).to(device, torch.float32),
        codes,
    )
