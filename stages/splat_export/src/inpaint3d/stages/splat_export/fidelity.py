"""How far pictures of splats are from photographs that they were not fitted to."""

from collections.abc import Callable, Sequence

import numpy as np

from inpaint3d.contracts.models.artifacts import SplatFidelity
from inpaint3d.perception import lpips
from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image
from inpaint3d.scene.masked_views import MaskedView
from inpaint3d.scene.psnr import mean_psnr, psnr
from inpaint3d.scene.ssim import ssim


def measure_fidelity(
    draw: Callable[[Camera], Image], photos: Sequence[MaskedView], field_psnr: float | None
) -> SplatFidelity | None:
    """Over the known pixels of photos of which `draw` makes pictures [h, w, 3]; None where no photo can be scored."""
    seen = [photo for photo in photos if photo.known.any()]
    pictures = [draw(photo.camera) for photo in seen]
    mean = mean_psnr(psnr(picture, photo.image, photo.known) for picture, photo in zip(pictures, seen, strict=True))
    if mean is None:
        return None
    network = lpips.load("vgg")
    similar, distant = [], []
    for picture, photo in zip(pictures, seen, strict=True):
        # Masked pixels are black in the photo: as black in the picture, they tell nothing.
        shown = np.where(photo.known[..., None], picture, photo.image)
        similar.append(ssim(shown, photo.image, photo.known))
        distant.append(network.distance(shown, photo.image))
    return SplatFidelity(
        photos=len(seen),
        psnr=mean,
        ssim=float(np.mean(similar)),
        lpips_vgg=float(np.mean(distant)),
        field_psnr=field_psnr,
    )
