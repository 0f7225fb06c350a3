"""SSIM of sRGB-encoded pictures in [0, 1], over all pixels or over a mask."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Mask = NDArray[np.bool_]

WINDOW = 11
SSIM_RADIUS = WINDOW // 2


def ssim_map(image: Image, truth: Image) -> NDArray[np.float64]:
    """Structural similarity at each pixel, [h, w], mean over channels.

    Wang et al. 2004: Gaussian window of sigma 1.5 cut to 11x11, K1 = 0.01, K2 = 0.03, range 1, population
    covariance. Borders are mirrored.
    """
    from skimage.metrics import structural_similarity

    x, y = _check(image, truth).astype(np.float64), truth.astype(np.float64)
    # scikit-image refuses a picture smaller than its window: it is given what it would have mirrored beyond the border.
    rows, columns = ((SSIM_RADIUS if side < WINDOW else 0,) * 2 for side in truth.shape[:2])
    x, y = (np.pad(picture, (rows, columns, (0, 0)), mode="symmetric") for picture in (x, y))
    found = structural_similarity(
        x, y, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1.0, channel_axis=-1, full=True
    )
    values = np.asarray(found[1])
    own = np.s_[rows[0] : len(values) - rows[0], columns[0] : values.shape[1] - columns[0]]
    return values[own].mean(-1)


def ssim(image: Image, truth: Image, region: Mask | None = None) -> float:
    """Mean of `ssim_map` over `region` ([h, w]), or over the pixels whose whole window lies in the picture.

    A picture smaller than the window is averaged everywhere. Raises ValueError where the region is empty.
    """
    values = ssim_map(image, truth)
    if region is not None:
        if not region.any():
            raise ValueError("SSIM over no pixel: the region is empty")
        return float(values[region].mean())
    inner = values[SSIM_RADIUS:-SSIM_RADIUS, SSIM_RADIUS:-SSIM_RADIUS]
    return float(inner.mean() if inner.size else values.mean())


def _check(image: Image, truth: Image) -> Image:
    if image.shape != truth.shape or image.ndim != 3:
        raise ValueError(f"pictures to compare are {image.shape} and {truth.shape}; both must be the same [h, w, 3]")
    return image
