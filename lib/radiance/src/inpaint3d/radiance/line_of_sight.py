"""Points as cameras saw them: the way there is clear, and there light stops."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from inpaint3d.radiance.rays import Rays
from inpaint3d.radiance.rendering import Rendering
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.capture_io import SparsePoints

# Light that stops within this share of a point's distance, before or behind it, counts as stopping at the point.
TOLERANCE = 0.03


@dataclass(frozen=True)
class SightLines:
    """Rays from cameras to the points that they saw, and the points' distances in scene units."""

    rays: Rays
    distance: Float[Tensor, " n"]

    @classmethod
    def of(
        cls,
        cameras: Sequence[Camera],
        points: SparsePoints,
        among: NDArray[np.bool_] | NDArray[np.int64] | None = None,
        device: torch.device | str = "cpu",
    ) -> "SightLines":
        """Of the rows of the tracks that `among` takes; None: of all. `points.track_frame` indexes `cameras`."""
        chosen = slice(None) if among is None else among
        origins = np.stack([camera.centre for camera in cameras])[points.track_frame[chosen]]
        return cls._join_points(origins, points.xyz[points.track_point[chosen]], device)

    @classmethod
    def of_surfaces(
        cls,
        surfaces: Sequence[tuple[Camera, NDArray[np.floating], NDArray[np.bool_]]],
        device: torch.device | str = "cpu",
    ) -> "SightLines":
        """Of the surfaces that cameras see at the chosen of their pixels: (camera, z [h, w], chosen [h, w]) of each."""
        origins, points = [np.empty((0, 3))], [np.empty((0, 3))]
        for camera, depth, chosen in surfaces:
            points.append(camera.unproject(camera.pixel_centres()[chosen], depth[chosen]))
            origins.append(np.broadcast_to(camera.centre, points[-1].shape))
        return cls._join_points(np.concatenate(origins), np.concatenate(points), device)

    @classmethod
    def _join_points(
        cls, origins: NDArray[np.floating], points: NDArray[np.floating], device: torch.device | str
    ) -> "SightLines":
        """From origins to points, [n, 3] both."""
        offsets = points - origins
        distance = np.linalg.norm(offsets, axis=1)
        # A point in the camera's centre gives no direction: its ray is left out.
        near = np.maximum(distance, np.finfo(np.float32).tiny)[:, None]
        arrays = (origins, offsets / near, distance)
        origin, direction, length = (torch.from_numpy(a).to(device, torch.float32) for a in arrays)
        return cls(Rays(origin, direction, None), length)

    def __len__(self) -> int:
        return len(self.distance)

    def draw(self, count: int, generator: torch.Generator) -> "SightLines":
        """`count` of them, drawn with replacement. Their view is the first: nobody looks at their colour."""
        chosen = torch.randint(len(self), (count,), generator=generator, device=generator.device)
        chosen = chosen.to(self.distance.device)
        origins, directions = self.rays.origins[chosen], self.rays.directions[chosen]
        return SightLines(Rays(origins, directions, torch.zeros_like(chosen)), self.distance[chosen])


def line_of_sight_loss(
    rendering: Rendering, part: slice, distance: Float[Tensor, " n"], tolerance: float = TOLERANCE
) -> Float[Tensor, ""]:
    """Light of the rays `part` that stops before their points, and light that passes them: shares, mean over rays.

    Photographs alone leave fog in the air for long, since fog of the right colour costs nothing. That rays are clear as
    far as a point that was matched in other photos is the prior of DS-NeRF (arXiv:2107.02791) and Urban Radiance Fields
    (arXiv:2111.14643); linear here, so that a wrong point pulls no harder than a right one.
    """
    weights, tdist = rendering.weights[part], rendering.tdist[part].detach()
    before = opacity_before(weights, tdist, (1 - tolerance) * distance)
    beyond = 1 - opacity_before(weights, tdist, (1 + tolerance) * distance)
    return (before + beyond).mean()


def opacity_before(
    weights: Float[Tensor, "n s"], tdist: Float[Tensor, "n s+1"], distance: Float[Tensor, " n"]
) -> Float[Tensor, " n"]:
    """Opacity that rays have gathered as far as a distance; within an interval it grows evenly."""
    low, high = tdist[:, :-1], tdist[:, 1:]
    share = (distance[:, None] - low) / (high - low).clamp(min=torch.finfo(tdist.dtype).tiny)
    return (weights * share.clamp(0, 1)).sum(1)
