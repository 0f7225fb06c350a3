"""Where rays ask the field: where it was dense when last asked.

Instant-NGP keeps the field's density in cells to skip empty space (arXiv:2201.05989, appendix C). Here the cells give a
histogram along each ray, and samples are drawn from that: there is no proposal network to ask or to train.
"""

from typing import TYPE_CHECKING

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int64
from torch import Tensor, nn

from inpaint3d.radiance.volume import alpha_weights

if TYPE_CHECKING:
    from inpaint3d.radiance.fields import RadianceField

# Per scene unit: what has not been looked at lets light through, but draws samples.
UNSEEN = 0.5
# What is left of a cell's density each time it is looked at again; it then rises to the largest that was seen.
MEMORY = 0.5
# Weight that every interval gets, so that what the cells have missed is found.
FLOOR = 0.01


class DensityGrid(nn.Module):
    """The densities that a field was seen to have, in `cells` per side of the cube that its hash grids live in."""

    density: Tensor

    def __init__(self, cells: int, bins: int) -> None:
        super().__init__()
        self.cells, self.bins = cells, bins
        self.register_buffer("density", torch.full((cells**3,), UNSEEN))
        self._noticed: list[tuple[Tensor, Tensor]] = []

    @torch.no_grad()
    def histogram(
        self, field: "RadianceField", origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]
    ) -> tuple[Float[Tensor, "r {self.bins}+1"], Float[Tensor, "r {self.bins}"]]:
        """Ends, evenly in s, and weights of each ray's intervals.

        The weights are those of volume rendering, spread to neighbours and raised by a floor as in Mip-NeRF
        (arXiv:2103.13415, section 3.1), since a surface may lie beside the middle that was looked up.
        """
        ends = torch.linspace(0, 1, self.bins + 1, device=origins.device).expand(len(origins), -1).contiguous()
        tdist = field.spacing.metric_from_normalised(ends)
        middle = (tdist[:, 1:] + tdist[:, :-1]) / 2
        points = torch.addcmul(origins[:, None], directions[:, None], middle[..., None]).reshape(-1, 3)
        weights = alpha_weights(self.density[self._cell(field.cube(points))].reshape(middle.shape), tdist)
        larger = F.max_pool1d(weights[:, None], 2, stride=1, padding=1)[:, 0]
        return ends, (larger[:, 1:] + larger[:, :-1]) / 2 + FLOOR

    @torch.no_grad()
    def notice(self, cube: Float[Tensor, "n 3"], density: Float[Tensor, " n"]) -> None:
        """Remember until `learn` what the field said of points of the cube."""
        self._noticed.append((self._cell(cube), density.detach()))

    @torch.no_grad()
    def learn(self) -> None:
        """Take in what was noticed since the last time: once a step, since a patch that is rendered again for its
        gradient must be sampled as it was.
        """
        if not self._noticed:
            return
        cell, density = (torch.cat(parts) for parts in zip(*self._noticed, strict=True))
        self._noticed.clear()
        self.density[cell] = MEMORY * self.density[cell]  # equal cells are given equal numbers: no order matters
        self.density.scatter_reduce_(0, cell, density, "amax")

    def _cell(self, cube: Float[Tensor, "n 3"]) -> Int64[Tensor, " n"]:
        x, y, z = (cube * self.cells).long().clamp_(0, self.cells - 1).unbind(1)
        return (z * self.cells + y) * self.cells + x
