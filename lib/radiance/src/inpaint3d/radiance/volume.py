"""Volume rendering along rays: from densities to the chance that light stops in each interval."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor


def alpha_weights(density: Float[Tensor, "*rays n"], tdist: Float[Tensor, "*rays n+1"]) -> Float[Tensor, "*rays n"]:
    """Chance that light stops in each interval (NeRF, arXiv:2003.08934, eq. 3).

    density is per scene unit, >= 0; tdist is sorted, along unit-length rays.
    The weights sum to at most 1; the rest is background.
    """
    optical_depth = density * torch.diff(tdist)
    # Shift, don't subtract: cumsum(x) - x forgets the fog in front of an opaque wall.
    before = F.pad(torch.cumsum(optical_depth[..., :-1], -1), (1, 0))
    # expm1 keeps thin fog: in float32, 1 - exp(-1e-8) is 0.
    return -torch.expm1(-optical_depth) * torch.exp(-before)


@torch.no_grad()
def median_distance(
    weights: Float[Tensor, "r s"], tdist: Float[Tensor, "r s+1"], far: float, smallest: float
) -> Float[Tensor, " r"]:
    """Distance at which half of a ray's opacity is reached, linear within the interval; `far` on empty rays.

    NaN where the weights do not sum to a finite opacity: such a ray is not an empty one.
    """
    reached = torch.cumsum(weights, -1)
    half = reached[:, -1:] / 2
    index = torch.searchsorted(reached, half).clamp_(max=weights.shape[1] - 1)
    within = weights.gather(1, index)
    before = reached.gather(1, index) - within
    share = ((half - before) / within).clamp_(0, 1)  # 0 / 0 on empty rays alone
    low, high = tdist.gather(1, index), tdist.gather(1, index + 1)
    return torch.where(reached[:, -1] <= smallest, far, (low + share * (high - low))[:, 0])
