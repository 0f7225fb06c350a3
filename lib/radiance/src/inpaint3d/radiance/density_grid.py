"""Where rays ask the field: where it was dense when last asked.

Instant-NGP keeps the field's density in cells to skip empty space (arXiv:2201.05989, appendix C). Here the cells give a
histogram along each ray, and samples are drawn from that: there is no proposal network to ask or to train.
"""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from inpaint3d.contracts.models.artifacts import FieldSpec
from inpaint3d.radiance import backends
from inpaint3d.radiance.spacing import Spacing

# Density of a cell that was never asked, per scene unit: thin enough not to hide what lies behind it, dense enough that
# samples are placed in it.
UNSEEN = 0.5
# A cell that is asked again keeps this share of its density, or takes the largest new one: it forgets what is gone.
MEMORY = 0.5
# Added to the weight of every interval, so that surfaces in cells that look empty still get samples.
FLOOR = 0.01


class DensityGrid(nn.Module):
    """The densities that a field was seen to have, in cells of the cube that its hash grids live in."""

    density: Tensor

    def __init__(self, spec: FieldSpec, spacing: Spacing) -> None:
        super().__init__()
        self.cells, self.bins = spec.density_cells, spec.density_bins
        self._spacing, self._contraction, self._bound = spacing, spec.contraction, spec.bound
        self.register_buffer("density", torch.full((self.cells**3,), UNSEEN))
        self._noticed: list[tuple[Tensor, Tensor]] = []

    @torch.no_grad()
    def histogram(
        self, backend: backends.Backend, origins: Float[Tensor, "r 3"], directions: Float[Tensor, "r 3"]
    ) -> tuple[Float[Tensor, "r {self.bins}+1"], Float[Tensor, "r {self.bins}"]]:
        """Ends, evenly in s, and weights of each ray's intervals (`backends.reference.grid_histogram`)."""
        ends = torch.linspace(0, 1, self.bins + 1, device=origins.device)
        tdist = self._spacing.metric_from_normalised(ends)
        cells = backends.Cells(self.density, self.cells, self._contraction, self._bound)
        weights = backend.grid_histogram(cells, origins, directions, tdist, FLOOR)
        return ends.expand(len(origins), -1), weights

    @torch.no_grad()
    def notice(self, cube: Float[Tensor, "n 3"], density: Float[Tensor, " n"]) -> None:
        """Remember until `learn` what the field said of points of the cube."""
        self._noticed.append((cube, density.detach()))

    @torch.no_grad()
    def learn(self, backend: backends.Backend) -> None:
        """Take in what was noticed since the last time: once a step, since a patch that is rendered again for its
        gradient must be sampled as it was.
        """
        if self._noticed:
            cube, density = (torch.cat(parts) for parts in zip(*self._noticed, strict=True))
            self._noticed.clear()
            backend.grid_learn(self.density, self.cells, cube, density, MEMORY)
