"""Filling a hole from its surroundings without learning; `pyramid_fill` is what the mask-channel condition shows."""

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor


def pyramid_fill(image: Float[Tensor, "b 3 h w"], mask: Float[Tensor, "b 1 h w"]) -> Float[Tensor, "b 3 h w"]:
    """Push-pull (Gortler et al., The Lumigraph, 1996, section 3.4): known pixels kept, the hole filled smoothly.

    mask is 1 inside the hole; what `image` holds there is never looked at. Averages of known pixels are pulled up a
    pyramid until nothing is unknown, then pushed back down into the holes. A picture that is all hole becomes 0 (mid
    grey in [-1, 1]). Cheap and deterministic, since it is redone at every query: training and distillation share it.
    """
    known = 1 - mask
    # where(), not a product: NaN or inf under the mask must not leak out of it.
    colour = torch.where(mask > 0, 0.0, image)
    return torch.where(mask > 0, _push_pull(colour, known), image)


def fill_telea(
    image: Float[np.ndarray, "h w 3"], hole: Bool[np.ndarray, "h w"], radius: float = 3.0
) -> Float[np.ndarray, "h w 3"]:
    """`image` in [0, 1] with `hole` filled by fast marching at 8 bits (Telea 2004, doi:10.1080/10867651.2004.10487596).

    radius: pixels that it looks around at. Known pixels are kept as they are.
    """
    codes = np.round(image.clip(0, 1) * 255).astype(np.uint8)
    made = cv2.inpaint(codes, hole.astype(np.uint8), radius, cv2.INPAINT_TELEA)
    return np.where(hole[..., None], made.astype(np.float32) / 255, image).astype(np.float32)


def _push_pull(premultiplied: Tensor, weight: Tensor) -> Tensor:
    """Colours [b, 3, h, w] from premultiplied ones and their weight in [0, 1]; full where the weight is 1."""
    solid = weight > 0
    colour = premultiplied / torch.where(solid, weight, 1.0)
    height, width = weight.shape[-2:]
    if height == 1 and width == 1:
        return colour
    half_colour = F.avg_pool2d(premultiplied, 2, ceil_mode=True)
    half_weight = F.avg_pool2d(weight, 2, ceil_mode=True)
    # Half a cell of known pixels is enough to colour it: colours from further away are mixed in below that only.
    full = torch.clamp(2 * half_weight, max=1.0)
    scale = full / torch.where(half_weight > 0, half_weight, 1.0)
    coarse = _push_pull(half_colour * scale, full)
    below = F.interpolate(coarse, size=(height, width), mode="bilinear", align_corners=False)
    return weight * colour + (1 - weight) * below
