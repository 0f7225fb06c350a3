"""The radiance field: hash grids and small networks (paper, appendix "Model Details"; conformance N1 to N6)."""

import contextlib
import math
from collections.abc import Generator
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance import backends, directions, safe
from inpaint3d.radiance.architecture import levels_of, parameter_shapes
from inpaint3d.radiance.density_grid import DensityGrid
from inpaint3d.radiance.memory import allocate_like
from inpaint3d.radiance.spacing import Spacing

# Raw outputs start near 0. Density e^-1 per scene unit lets light through the whole scene at first.
DENSITY_SHIFT = -1.0


class Samples(NamedTuple):
    """What a field says of points in space."""

    density: Float[Tensor, " n"]  # per scene unit
    rgb: Float[Tensor, "n 3"]
    diffuse: Float[Tensor, "n 3"]


class RadianceField(nn.Module):
    """A field with diffuse and view-dependent colour, and what says where rays ask it: a proposal network, shared by
    its rounds, or a density grid.

    `backend` names the implementation of the heavy operations (default: the fastest that is installed). Raises
    ConfigurationError for an architecture that cannot be built.
    """

    def __init__(self, spec: FieldSpec, seed: int, backend: backends.Name | None = None) -> None:
        super().__init__()
        _check(spec)
        self.spec = spec
        self._backend_name: backends.Name | None = backend
        self.spacing = Spacing(spec.near, spec.far, spec.contraction)
        shapes = parameter_shapes(spec)
        generator = torch.Generator().manual_seed(seed)
        weights = {
            name: nn.Parameter(_start(name, shape, generator))
            for name, shape in shapes.items()
            if not name.startswith("density_grid.")
        }
        self.proposal = self.density_grid = None
        if spec.sampler == "proposal":
            self.proposal = HashNetwork(spec.proposal_grid, "proposal", weights)
        else:
            self.density_grid = DensityGrid(spec, self.spacing)
        self.base = HashNetwork(spec.grid, "base", weights)
        self.specular = nn.ParameterList([w for name, w in weights.items() if name.startswith("specular.")])
        if spec.glo:
            self.codes, self.code_map = weights["codes"], weights["code_map"]

    @property
    def device(self) -> torch.device:
        return self.base.table.device

    @property
    def backend(self) -> backends.Backend:
        return backends.select(self.device, self._backend_name)

    @contextlib.contextmanager
    def on_backend(self, name: backends.Name) -> Generator[None]:
        """Compute with another backend for a while."""
        before, self._backend_name = self._backend_name, name
        try:
            yield
        finally:
            self._backend_name = before

    @property
    def hash_networks(self) -> list["HashNetwork"]:
        """The proposal network, if there is one, and the field's own."""
        return [self.base] if self.proposal is None else [self.proposal, self.base]

    def cube(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, "n 3"]:
        """Scene points in the grids' cube, [0, 1]^3. Without contraction, space beyond it continues its border."""
        cube = self.backend.unit_cube(points, self.spec.contraction, self.spec.bound)
        return cube if self.spec.contraction else cube.clamp(0, 1)

    def proposal_density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Density that the proposal network guesses at scene points, per scene unit."""
        if self.proposal is None:
            raise ValueError(f"a field whose sampler is {self.spec.sampler!r} has no proposal network")
        return _to_density(self.proposal(self.cube(points), self.backend)[:, 0])

    def density(self, points: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Density at scene points, per scene unit."""
        return _to_density(self.base(self.cube(points), self.backend)[:, 0])

    def appearance(
        self, view: Int64[Tensor, " n"] | None, glo: Literal["view", "mean"]
    ) -> Float[Tensor, "n 6"] | Float[Tensor, "1 6"] | None:
        """Log gain and offset of colour logits for each ray's view (N6); one row for the mean code; None without."""
        if not self.spec.glo:
            return None
        codes = self.codes.mean(0, keepdim=True) if glo == "mean" or view is None else self.codes[view]
        return codes @ self.code_map

    def query(
        self,
        points: Float[Tensor, "n 3"],
        towards: Float[Tensor, "m 3"],
        appearance: Float[Tensor, "_ 6"] | None = None,
        specular_scale: float = 1.0,
    ) -> Samples:
        """Density and colours at scene points seen along unit directions.

        towards: one direction for each run of n / m points: each point's own, or its ray's. Colours are those of
        `backends.reference.colours`; `appearance`: gain and offset of each direction's view, or of all.
        """
        heads = self.base(self.cube(points), self.backend)
        # Split, not sliced: one gradient, not a sum of three.
        raw, diffuse, bottleneck = heads.split([1, 3, heads.shape[1] - 4], 1)
        specular = None
        if self.spec.view_layers:
            first, *others = self.specular
            along, across = first.split([bottleneck.shape[1], first.shape[1] - bottleneck.shape[1]], 1)
            starts = directions.spherical_harmonics(towards) @ across.T
            specular = self.backend.mlp(bottleneck, [along, *others], starts)
        return Samples(_to_density(raw[:, 0]), *self.backend.colours(diffuse, specular, appearance, specular_scale))


class HashNetwork(nn.Module):
    """A hash grid and a network without biases on its features."""

    def __init__(self, grid: GridSpec, name: str, weights: dict[str, nn.Parameter]) -> None:
        super().__init__()
        self.levels = levels_of(grid.levels, grid.coarsest, grid.finest, grid.log2_table)
        self.table = weights[f"{name}.table"]
        self.weights = nn.ParameterList([w for key, w in weights.items() if key.startswith(f"{name}.weights.")])

    def forward(self, cube: Float[Tensor, "n 3"], backend: backends.Backend) -> Float[Tensor, "n _"]:
        return backend.mlp(backend.hash_encode(cube, self.table, self.levels), list(self.weights))


def _start(name: str, shape: tuple[int, ...], generator: torch.Generator) -> Tensor:
    """Where each weight starts."""
    if name == "codes":
        return torch.zeros(shape)
    spread = torch.rand(shape, generator=generator) * 2 - 1
    if name.endswith("table"):
        # Instant-NGP's start: small enough that colours and densities begin alike everywhere.
        return torch.mul(spread, 1e-4, out=allocate_like(spread))
    # He's uniform start for layers of ReLU, [out, in]; `code_map` is [in, out].
    return spread * math.sqrt(6 / shape[0 if name == "code_map" else 1])


def _to_density(raw: Float[Tensor, " n"]) -> Float[Tensor, " n"]:
    return safe.exp(raw + DENSITY_SHIFT)


def _check(spec: FieldSpec) -> None:
    rounds = (*(spec.proposal_samples if spec.sampler == "proposal" else (spec.density_bins,)), spec.samples)
    if min(rounds) < 2:
        raise ConfigurationError(f"samples per round are {rounds}; each must be at least 2")
    if spec.near >= spec.far:
        raise ConfigurationError(f"near {spec.near} is not below far {spec.far}")
    if spec.view_layers and not spec.bottleneck:
        raise ConfigurationError("view-dependent colour needs a bottleneck of at least 1; set view_layers to 0 without")
