"""A copy of a prior that learns little: low-rank changes of its weights (LoRA, arXiv:2106.09685), for VSD."""

from copy import deepcopy

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from inpaint3d.diffusion.denoiser import Image, Mask
from inpaint3d.diffusion.prior import InpaintingPrior
from inpaint3d.diffusion.training import Batch, denoising_loss


class LowRankCopy:
    """The prior plus `rank` directions in every convolution and linear layer; it starts as the prior itself.

    parameters: what learns. optimiser: Adam over them at `rate`.
    """

    def __init__(self, prior: InpaintingPrior, *, rank: int = 4, rate: float = 1e-3, seed: int = 0) -> None:
        self.network = deepcopy(prior).requires_grad_(False)
        generator = torch.Generator().manual_seed(seed)
        for layer in [m for m in self.network.modules() if isinstance(m, nn.Conv2d | nn.Linear)]:
            parametrize.register_parametrization(layer, "weight", _LowRank(layer.weight, rank, generator))
        self.parameters = [p for p in self.network.parameters() if p.requires_grad]
        self.optimiser = torch.optim.Adam(self.parameters, lr=rate)

    def learn(self, x: Image, mask: Mask, generator: torch.Generator, t_range: tuple[float, float]) -> None:
        """One step towards the distribution of the renders x, all of whose pixels count as truth."""
        batch = Batch(x.detach(), mask, torch.ones_like(mask))
        loss = denoising_loss(self.network, batch, generator, t_range)
        self.optimiser.zero_grad()
        loss.backward()
        self.optimiser.step()

    def state(self) -> dict[str, Tensor]:
        """Weights and moments, for a checkpoint."""
        tensors = {f"{i}.weight": p.detach() for i, p in enumerate(self.parameters)}
        for i, parameter in enumerate(self.parameters):
            tensors |= {f"{i}.{name}": value for name, value in self.optimiser.state[parameter].items()}
        return tensors

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """From a checkpoint."""
        with torch.no_grad():
            for i, parameter in enumerate(self.parameters):
                parameter.copy_(tensors[f"{i}.weight"])
                kept = {n.partition(".")[2]: t for n, t in tensors.items() if n.startswith(f"{i}.")}
                # Adam counts its steps on the processor; moments lie beside their parameter.
                self.optimiser.state[parameter] = {
                    n: t.clone() if t.ndim == 0 else t.to(parameter.device, copy=True)
                    for n, t in kept.items()
                    if n != "weight"
                }


class _LowRank(nn.Module):
    """weight + up @ down, where up starts at 0."""

    def __init__(self, weight: Tensor, rank: int, generator: torch.Generator) -> None:
        super().__init__()
        rows, columns = weight.shape[0], weight[0].numel()
        down = torch.randn(rank, columns, generator=generator) / columns**0.5
        self.down = nn.Parameter(down.to(weight.device))
        self.up = nn.Parameter(weight.new_zeros(rows, rank))

    def forward(self, weight: Tensor) -> Tensor:
        return weight + (self.up @ self.down).view_as(weight)
