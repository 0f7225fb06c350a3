"""The radiance fields under test, and what they render."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.models.artifacts import RadianceFieldArtifact
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.io import load_field
from inpaint3d.radiance.rays import camera_rays
from inpaint3d.radiance.rendering import EMPTY, render, render_view
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Mask
from inpaint3d.stages.evaluation.boxes import Box
from inpaint3d.stages.evaluation.photos import Photo

Maps = dict[str, NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class Method:
    """A field with its name in the tables."""

    label: str
    field: RadianceField
    artifact: Artifact[RadianceFieldArtifact]

    def render(self, photo: Photo, block: int, box: Box | None = None) -> Maps:
        """Colour rgb [h, w, 3], opacity and depth along the axis [h, w]; of a box, or the whole view."""
        camera = photo.camera if box is None else crop_camera(photo.camera, box)
        maps = render_view(self.field, camera, block=block, view=photo.exposure)
        return {name: maps[name] for name in ("rgb", "opacity", "depth")}

    @torch.no_grad()
    def depth_spread(self, photo: Photo, region: Mask, block: int) -> float:
        """How far a region's light stops before and behind its mean distance, as a share of it; mean over the rays.

        The square root of the depth's variance along a ray: 0 is a surface, fog is far from it.
        """
        y, x = np.nonzero(region)
        rays = camera_rays(photo.camera, np.stack([x + 0.5, y + 0.5], -1), device=self.field.device)
        shares: list[torch.Tensor] = []
        for start in range(0, len(x), block):
            seen = render(self.field, rays[start : start + block], glo="mean")
            middle = (seen.tdist[:, 1:] + seen.tdist[:, :-1]) / 2
            weight = seen.weights / seen.weights.sum(1, keepdim=True).clamp(min=EMPTY)
            mean = (weight * middle).sum(1, keepdim=True)
            variance = (weight * (middle - mean).square()).sum(1)
            shares.append(variance.sqrt() / mean[:, 0].clamp(min=EMPTY))
        return float(torch.cat(shares).mean())


def load_methods(artifacts: list[Artifact[RadianceFieldArtifact]], device: str) -> list[Method]:
    """The fields in the order they are wired; labels that repeat get their seeds, or where those repeat a number."""
    named = [(a.metadata.label, a.metadata.seed) for a in artifacts]
    methods: list[Method] = []
    for i, artifact in enumerate(artifacts):
        label, seed = named[i]
        seeds = [s for other, s in named if other == label]
        if len(set(seeds)) == len(seeds) > 1:
            label = f"{label}, seed {seed}"
        elif same := sum(other == label for other, _ in named[:i]):
            label = f"{label} #{same + 1}"
        field = load_field(artifact.path(artifact.metadata.weights), artifact.metadata.spec).to(device).eval()
        methods.append(Method(label, field, artifact))
    return methods


def crop_camera(camera: Camera, box: Box) -> Camera:
    """The camera of a part of its picture: the same rays, counted from the box's corner."""
    return replace(camera, cx=camera.cx - box.x0, cy=camera.cy - box.y0, width=box.width, height=box.height)


def count_non_finite(maps: Maps) -> int:
    """How many values of a render are not finite."""
    return int(sum(np.count_nonzero(~np.isfinite(values)) for values in maps.values()))
