"""Three kinds of holes, and what fills them: priors and classical methods."""

from collections.abc import Callable, Mapping

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from inpaint3d.diffusion.judging import fill_batch_telea, to_bytes
from inpaint3d.diffusion.masks import random_masks
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.samplers import inpaint

SEED = 20
BATCH = 10
Fill = Callable[[Tensor, Tensor], Tensor]


def large(size: int, rng: np.random.Generator) -> np.ndarray:
    """One box over a third to two thirds of the picture."""
    height, width = (round(extent) for extent in np.sqrt(rng.uniform(1 / 3, 2 / 3)) * size * _aspect(rng))
    y, x = (int(rng.integers(size - extent + 1)) for extent in (height, width))
    mask = np.zeros((size, size), bool)
    mask[y : y + height, x : x + width] = True
    return mask


def _aspect(rng: np.random.Generator) -> np.ndarray:
    stretch = rng.uniform(0.85, 1.15)
    return np.array([stretch, 1 / stretch])


HOLES: Mapping[str, Callable[[int, np.random.Generator], np.ndarray]] = {
    "rectangles": lambda size, rng: random_masks(1, size, rng, {"rectangles": 1.0})[0],
    "strokes": lambda size, rng: random_masks(1, size, rng, {"strokes": 1.0})[0],
    "large": large,
}


def sample_by(prior: InpaintingPrior, steps: int) -> Fill:
    """Samples of a prior, at its own size."""

    def sample(image: Tensor, hole: Tensor) -> Tensor:
        generator = torch.Generator().manual_seed(SEED)
        parts = zip(image.split(BATCH), hole.split(BATCH), strict=True)
        return torch.cat([inpaint(prior, x, m, steps=steps, generator=generator) for x, m in parts])

    def resized(image: Tensor, hole: Tensor) -> Tensor:
        if image.shape[-1] == prior.size:
            return sample(image, hole)
        size = (prior.size, prior.size)
        # A cell that the hole touches is the hole's: it is an average over pixels that nobody may see.
        made = sample(F.interpolate(image, size, mode="area"), F.adaptive_max_pool2d(hole, size))
        return torch.where(hole > 0, F.interpolate(made, image.shape[-2:], mode="bilinear"), image)

    return resized


def choose_fills(priors: Mapping[str, InpaintingPrior], steps: int) -> dict[str, Fill]:
    return {
        **{name: sample_by(prior, steps) for name, prior in priors.items()},
        "mean": mean_fill,
        "telea": fill_batch_telea,
        "navier_stokes": each(lambda picture, hole: cv2.inpaint(picture, hole, 3, cv2.INPAINT_NS)),
        "patch": each(shift_map),
    }


def mean_fill(image: Tensor, hole: Tensor) -> Tensor:
    known = 1 - hole
    mean = (image * known).sum(dim=(2, 3), keepdim=True) / known.sum(dim=(2, 3), keepdim=True)
    return torch.where(hole > 0, mean, image)


def each(fill: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Fill:
    """A fill of 8-bit pictures [h, w, 3] under holes [h, w], 1 inside, as one of batches; known pixels are kept."""

    def whole(image: Tensor, hole: Tensor) -> Tensor:
        filled = [fill(to_bytes(p), h[0].byte().numpy()) for p, h in zip(image, hole, strict=True)]
        pictures = torch.from_numpy(np.stack(filled)).permute(0, 3, 1, 2).float() / 127.5 - 1
        return torch.where(hole > 0, pictures, image)

    return whole


def shift_map(picture: np.ndarray, hole: np.ndarray) -> np.ndarray:
    lab, filled = cv2.cvtColor(picture, cv2.COLOR_RGB2Lab), np.zeros_like(picture)
    # Its mask is that of the known pixels.
    cv2.xphoto.inpaint(lab, (1 - hole) * 255, filled, cv2.xphoto.INPAINT_SHIFTMAP)
    return cv2.cvtColor(filled, cv2.COLOR_Lab2RGB)
