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

# Per scene unit: what has not been looked at lets light through, but draws samples.
UNSEEN = 0.5
# What is left of a cell's density each time it is looked at again; it then rises to the largest that was seen.
MEMORY = 0.5
# Weight that every interval gets, so that what the cells have missed is found.
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
        weights = backend.grid_histogram(
            self.density, self.cells, origins, directions, tdist, self._contraction, self._bound, FLOOR
        )
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
