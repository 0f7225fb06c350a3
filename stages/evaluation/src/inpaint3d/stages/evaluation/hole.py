"""What can be said of a hole: is it opaque, as lively as its surround or the truth, the same from the next view?"""

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]
OPAQUE = 0.95


def opacity_figures(opacity: NDArray[np.float32], mask: Mask) -> dict[str, float]:
    """Mean, minimum and share of opaque (>= 0.95) pixels of a rendered opacity [h, w] inside the mask [h, w].

    A fog or a gap where the object was shows here. The mask must hold a pixel.
    """
    inside = opacity[mask].astype(np.float64)
    return {
        "opacity_mean": float(inside.mean()),
        "opacity_min": float(inside.min()),
        "opaque_share": float((inside >= OPAQUE).mean()),
    }


def gradient_ratio(image: NDArray[np.float32], mask: Mask, ring: Mask) -> float | None:
    """Gradient energy inside the mask over that in the ring around it: 1 is alike, near 0 blurred, well above 1 noisy.

    Energy is the mean square of forward differences of the luma; only differences with both pixels in a
    region count. None where either region holds no such pair, or the surround is perfectly flat.
    """
    inside, around = _measure_energy(image, mask), _measure_energy(image, ring)
    if inside is None or not around:
        return None
    return inside / around


def gradient_share(image: NDArray[np.float32], truth: NDArray[np.float32], mask: Mask) -> float | None:
    """Gradient energy inside the mask over that of the truth there: under 1 is blur, above 1 noise.

    None where the mask holds no two neighbouring pixels, or the truth is perfectly flat.
    """
    made, real = _measure_energy(image, mask), _measure_energy(truth, mask)
    return made / real if made is not None and real else None


def reprojection_figures(
    image: NDArray[np.float32], neighbour: NDArray[np.float32], seen: Mask, mask: Mask, known: Mask
) -> dict[str, float]:
    """Mean colour difference between a view [h, w, 3] and its neighbour warped to it, where both see the same surface.

    Inside the mask and, to compare with, over known pixels; a region that the neighbour does not see has no figure.
    """
    apart = np.abs(image.astype(np.float64) - neighbour).mean(-1)
    regions = {"reprojection_hole": mask & seen, "reprojection_known": known & seen}
    return {name: float(apart[region].mean()) for name, region in regions.items() if region.any()}


def _measure_energy(image: NDArray[np.float32], region: Mask) -> float | None:
    luma = image.astype(np.float64) @ np.array([0.299, 0.587, 0.114])
    across, down = np.diff(luma, axis=1) ** 2, np.diff(luma, axis=0) ** 2
    both_across, both_down = region[:, 1:] & region[:, :-1], region[1:] & region[:-1]
    count = int(both_across.sum() + both_down.sum())
    if count == 0:
        return None
    return float((across[both_across].sum() + down[both_down].sum()) / count)
