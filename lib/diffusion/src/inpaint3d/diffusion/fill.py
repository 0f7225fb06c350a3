"""Filling a hole from its surroundings without learning: what the mask-channel condition shows inside the hole."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
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


def _push_pull(premultiplied: Tensor, weight: Tensor) -> Tensor:
    """Colours [b, 3, h, w] from premultiplied ones and their weight in [0, 1]; full where the weight is 1."""
    solid = weight > 0
    colour = torch.where(solid, premultiplied / torch.where(solid, weight, 1.0), 0.0)
    height, width = weight.shape[-2:]
    if height == 1 and width == 1:
        return colour
    half_colour = F.avg_pool2d(premultiplied, 2, ceil_mode=True)
    half_weight = F.avg_pool2d(weight, 2, ceil_mode=True)
    # A cell counts as full once half of it is known: it then no longer bleeds in colours from further away.
    full = torch.clamp(2 * half_weight, max=1.0)
    scale = full / torch.where(half_weight > 0, half_weight, 1.0)
    coarse = _push_pull(half_colour * scale, full)
    below = F.interpolate(coarse, size=(height, width), mode="bilinear", align_corners=False)
    return weight * colour + (1 - weight) * below
