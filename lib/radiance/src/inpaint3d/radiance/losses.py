"""The paper's losses on a field (equations in the method section, details in its appendix; conformance L1 to L8)."""

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.radiance import backends
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rendering import Rendering
from inpaint3d.radiance.spacing import below_limit


def charbonnier(residual: Float[Tensor, "*n"], eps: float = 1e-3) -> Float[Tensor, "*n"]:
    """sqrt(residual^2 + eps^2) of each element (L1).

    The paper prints a minus sign: NaN for every residual under eps. hypot, since the square overflows first.
    """
    return torch.hypot(residual, residual.new_tensor(eps))


def interlevel_loss(rendering: Rendering) -> Float[Tensor, ""]:
    """How far the proposals' histograms fail to bound the field's (Mip-NeRF 360, arXiv:2111.12077, eq. 13; L5).

    Sum over the rounds, mean over rays. Gradients reach the proposals alone.
    """
    ends, weights = rendering.sdist.detach().flatten(0, -2), rendering.weights.detach().flatten(0, -2)
    total = weights.new_zeros(())
    for proposal_ends, proposal_weights in rendering.proposals:
        proposal = proposal_ends.flatten(0, -2), proposal_weights.flatten(0, -2)
        total = total + backends.select(ends.device).interlevel(ends, weights, *proposal).mean()
    return total


def distortion_loss(rendering: Rendering, p: float = -1.0, premult: float = 20000.0) -> Float[Tensor, ""]:
    """Spread of the weights along rays, distances curved by the power ladder P (Zip-NeRF, arXiv:2304.06706; L4).

    sum_ij w_i w_j |u_i - u_j| + 1/3 sum_i w_i^2 |interval i|, u = P(t, p, premult) at the middles; mean over rays.
    """
    ends = -below_limit(rendering.tdist.detach(), p, premult)
    return distortion(rendering.weights, ends).mean()


def distortion(weights: Float[Tensor, "*r n"], ends: Float[Tensor, "*r n+1"]) -> Float[Tensor, "*r"]:
    """The double sum in linear time: the gap between neighbours counts for all pairs that it separates."""
    middle = (ends[..., 1:] + ends[..., :-1]) / 2
    before = torch.cumsum(weights[..., :-1], -1)
    after = torch.cumsum(weights[..., 1:].flip(-1), -1).flip(-1)
    between = 2 * (torch.diff(middle) * before * after).sum(-1)
    within = (weights.square() * torch.diff(ends)).sum(-1) / 3
    return between + within


def depth_smoothness_loss(
    depth: Float[Tensor, "p h w"], rgb: Float[Tensor, "p h w 3"], colour_sigma: float = 0.1
) -> Float[Tensor, ""]:
    """Squared depth differences of neighbours in patches (RegNeRF, arXiv:2112.00724, eq. 5), mean over pixels (L6).

    Bilateral: exp(-|colour difference|^2 / (2 sigma^2)) lets depth break where the rendered colour does; detached, else
    colours would change in order to excuse depths.
    """
    total = depth.new_zeros(())
    for axis in (1, 2):
        step = torch.diff(depth, dim=axis)
        colour_step = torch.diff(rgb.detach(), dim=axis).square().sum(-1)
        total = total + (torch.exp(-colour_step / (2 * colour_sigma**2)) * step.square()).sum()
    return total / depth.numel()


def hash_decay(field: RadianceField) -> Float[Tensor, ""]:
    """Sum over the levels of all hash grids of the mean square of their entries (Zip-NeRF, arXiv:2304.06706; N9).

    `optim.Adam` adds this term's gradient by itself: as a term of the loss it would cost a pass over all entries more.
    """
    # Split, not sliced: one gradient of a table, not a table of zeros for each level.
    parts = [part for net in field.hash_networks for part in net.table.split([level.size for level in net.levels])]
    return torch.stack([part.square().mean() for part in parts]).sum()
