"""What a textured mesh looks like from cameras, and how far that is from photographs that it was not made of."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from skimage.metrics import structural_similarity

from inpaint3d.scene.cameras import Camera
from inpaint3d.scene.image_io import Image, Mask
from inpaint3d.scene.psnr import mean_psnr, psnr
from inpaint3d.scene.reprojection import sample_bilinear
from inpaint3d.stages.usd_export.rays import Caster

BACKGROUND = 0.5  # where the mesh has a hole


class HeldOutPhoto(NamedTuple):
    """A photo [h, w, 3] that no texture was made of, and which of its pixels count, bool [h, w]."""

    camera: Camera
    image: Image
    known: Mask


def render_mesh(caster: Caster, coordinates: NDArray[np.float32], texture: Image, camera: Camera) -> Image:
    """The mesh as a camera sees it [h, w, 3]: its texture as it is, unlit; coordinates [t, 3, 2] as USD has them."""
    hits = caster.look(camera)
    met = hits.triangle >= 0
    uv = np.einsum("nc,ncd->nd", hits.barycentric[met], coordinates[hits.triangle[met]])
    picture = np.full((len(met), 3), BACKGROUND, np.float32)
    picture[met] = sample_bilinear(texture, np.stack([uv[:, 0], 1 - uv[:, 1]], -1) * texture.shape[0])
    return picture.reshape(camera.height, camera.width, 3)


def measure_fidelity(
    caster: Caster, coordinates: NDArray[np.float32], texture: Image, photos: Sequence[HeldOutPhoto]
) -> tuple[float, float] | None:
    """PSNR (dB) and SSIM over the known pixels, means over the photos; None where no photo has a finite PSNR."""
    scores = [
        _score(render_mesh(caster, coordinates, texture, photo.camera), photo) for photo in photos if photo.known.any()
    ]
    mean = mean_psnr(decibels for decibels, _ in scores)
    return None if mean is None else (mean, float(np.mean([similarity for _, similarity in scores])))


def _score(picture: Image, photo: HeldOutPhoto) -> tuple[float, float]:
    window = min(7, min(photo.known.shape) // 2 * 2 - 1)
    similar = structural_similarity(photo.image, picture, win_size=window, channel_axis=-1, data_range=1.0, full=True)[
        1
    ]
    return psnr(picture, photo.image, photo.known), float(np.asarray(similar)[photo.known].mean())
