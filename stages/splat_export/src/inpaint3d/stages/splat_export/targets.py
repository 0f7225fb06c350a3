"""What the splats are to look like: photographs outside the mask, inside it what was inpainted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from inpaint3d.contracts.errors import BadInputError
from inpaint3d.contracts.models.artifacts import CompletedViews
from inpaint3d.contracts.store import Artifact
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import camera_rays
from inpaint3d.radiance.rendering import render
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.colour import from_bytes, to_bytes
from inpaint3d.scene.image_io import Image, Mask, read_image
from inpaint3d.scene.masked_views import MaskedView


@dataclass(frozen=True, eq=False)
class Target:
    """A picture, 8-bit sRGB [h, w, 3], and which of its pixels count, bool [h, w]. Bytes, since all views are held."""

    name: str
    camera: Camera
    codes: NDArray[np.uint8]
    counts: Mask

    @property
    def picture(self) -> Image:
        """float32 in [0, 1]."""
        return from_bytes(self.codes)


def load_targets(
    views: Sequence[MaskedView], completed: Artifact[CompletedViews] | None, field: RadianceField | None, block: int
) -> list[Target]:
    """One for each view: the photo where it is known, in the hole the completed view, or where there is none the field.

    Masked pixels of a photo are in no target: `MaskedView` has blanked them. BadInputError where completed views are of
    another capture.
    """
    files = {view.name: view.picture for view in completed.metadata.views} if completed else {}
    targets: list[Target] = []
    for view in views:
        if completed is not None and view.name in files:
            filled = _read_completed(view, completed, files[view.name])
        elif field is not None:
            filled = render_hole(field, view, block)
        else:
            raise BadInputError(f"view {view.name} has not been completed; re-run view-completion on this capture")
        picture = np.where(view.known[..., None], view.image, filled)
        targets.append(Target(view.name, view.camera, to_bytes(picture), view.known | view.hole))
    return targets


def _read_completed(view: MaskedView, completed: Artifact[CompletedViews], file: str) -> Image:
    picture = read_image(completed.path(file))
    if picture.shape != view.image.shape:
        raise BadInputError(
            f"the completed view {view.name} has {picture.shape[1]} x {picture.shape[0]} pixels, its photo "
            f"{view.image.shape[1]} x {view.image.shape[0]}; re-run view-completion on this capture"
        )
    return picture


@torch.no_grad()
def render_hole(field: RadianceField, view: MaskedView, block: int) -> Image:
    """What a field shows in a view's hole [h, w, 3], mean appearance; 0 elsewhere."""
    picture = np.zeros_like(view.image)
    rays = camera_rays(view.camera, view.camera.pixel_centres()[view.hole])
    parts = [render(field, rays[i : i + block], glo="mean").rgb for i in range(0, len(rays.origins), block)]
    if parts:
        picture[view.hole] = torch.cat(parts).clamp(0, 1).numpy()
    return picture
