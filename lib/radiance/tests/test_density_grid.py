import pytest
import torch

from inpaint3d.contracts.errors import ConfigurationError
from inpaint3d.contracts.models.artifacts import FieldSpec, GridSpec
from inpaint3d.radiance.backends import select
from inpaint3d.radiance.density_grid import FLOOR, MEMORY, UNSEEN, DensityGrid
from inpaint3d.radiance.fields import RadianceField
from inpaint3d.radiance.rays import Rays
from inpaint3d.radiance.rendering import render
from inpaint3d.radiance.spacing import Spacing

SPEC = FieldSpec(
    sampler="density-grid", density_cells=32, density_bins=48,
    grid=GridSpec(levels=3, coarsest=4, finest=32, log2_table=8, channels=2),
    samples=12, density_width=8, bottleneck=3, view_width=8, view_layers=1, near=0.05, far=100.0,
)  # fmt: skip


def rays(count: int) -> Rays:
    """From around (0.9, 0, 0), towards the origin."""
    generator = torch.Generator().manual_seed(0)
    origins = torch.tensor([0.9, 0.0, 0.0]) + 0.05 * torch.randn(count, 3, generator=generator)
    return Rays(origins, torch.nn.functional.normalize(-origins, dim=-1), None)


def wall(field: RadianceField, low: float, high: float, density: float) -> None:
    """Nothing anywhere but a slab low < x < high of scene space, inside the unit ball."""
    grid = field.density_grid
    assert grid is not None
    side = (torch.arange(grid.cells) + 0.5) / grid.cells * 4 - 2
    slab = ((side > low) & (side < high)).float() * density
    grid.density.copy_(slab.expand(grid.cells, grid.cells, grid.cells).reshape(-1))


def test_samples_gather_where_the_grid_is_dense() -> None:
    field, toward = RadianceField(SPEC, 0), rays(20)
    wall(field, -0.25, 0.0, 1e3)
    seen = render(field, toward)
    middle = (seen.tdist[:, 1:] + seen.tdist[:, :-1]) / 2
    x = toward.origins[:, :1] + toward.directions[:, :1] * middle
    near_wall = (x > -0.25 - 0.3) & (x < 0.3)
    # The histogram: 1 at the wall and FLOOR everywhere.
    assert near_wall.float().mean() > 0.5
    assert near_wall.any(1).all()
    # The floor leaves some elsewhere.
    assert not near_wall.all()


def test_the_histogram_is_the_walls_weights_spread_to_neighbours_and_raised() -> None:
    field, toward = RadianceField(SPEC, 0), rays(5)
    wall(field, -0.25, 0.0, 1e6)
    assert field.density_grid is not None
    ends, weights = field.density_grid.histogram(field.backend, toward.origins, toward.directions)
    assert ends.shape == (5, 49)
    assert weights.shape == (5, 48)
    # An opaque first interval gives 1 to itself and half of that to either side.
    assert weights.sum(1) - 48 * FLOOR == pytest.approx(torch.full((5,), 2.0).numpy(), abs=1e-4)
    assert weights.max(1).values.numpy() == pytest.approx(1 + FLOOR, abs=1e-4)


def test_a_cell_rises_at_once_and_falls_by_degrees() -> None:
    spec = SPEC.model_copy(update={"density_cells": 4, "density_bins": 8})
    grid = DensityGrid(spec, Spacing(0.05, 100.0, True))
    middle, corner = torch.tensor([[0.6, 0.6, 0.6]]), torch.tensor([[0.01, 0.01, 0.99]])

    def learn(points: torch.Tensor, density: list[float]) -> None:
        grid.notice(points, torch.tensor(density))
        grid.learn(select("cpu"))

    learn(torch.cat([middle, middle, corner]), [3.0, 7.0, 0.0])
    (cell,) = (grid.density == 7).nonzero()
    assert cell == (2 * 4 + 2) * 4 + 2
    assert grid.density[3 * 16] == MEMORY * UNSEEN
    assert (grid.density == UNSEEN).sum() == 62
    learn(middle, [0.0])
    assert grid.density[cell] == 7 * MEMORY
    # Outside the cube its border is learnt, not some other place.
    learn(torch.tensor([[1.5, -3.0, 0.01]]), [9.0])
    assert grid.density[3] == 9


def test_training_teaches_the_grid_and_looking_does_not() -> None:
    field, toward = RadianceField(SPEC, 0), rays(64)
    assert field.density_grid is not None
    before = field.density_grid.density.clone()
    render(field, toward)
    field.density_grid.learn(field.backend)
    assert torch.equal(field.density_grid.density, before)
    renders = [render(field, toward, generator=torch.Generator().manual_seed(1)) for _ in range(2)]
    assert torch.equal(renders[0].sdist, renders[1].sdist), "nothing is learnt in the middle of a step"
    field.density_grid.learn(field.backend)
    learnt = field.density_grid.density != before
    # 64 x 12 samples, most in cells of their own or shared with a neighbour's ray.
    assert 50 < learnt.sum() < 64 * 12
    density = field.density_grid.density[learnt]
    assert (density < UNSEEN).all()  # a fresh field is thinner than what has not been seen


def test_bits_do_not_depend_on_threads() -> None:
    results = []
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        field = RadianceField(SPEC, 0)
        generator = torch.Generator().manual_seed(0)
        for _ in range(3):
            render(field, rays(3000), generator=generator)
            assert field.density_grid is not None
            field.density_grid.learn(field.backend)
        results.append(field.density_grid.density)
    torch.set_num_threads(1)
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2])


def test_there_is_no_proposal_network_to_ask() -> None:
    field = RadianceField(SPEC, 0)
    assert not [name for name, _ in field.named_parameters() if name.startswith("proposal")]
    with pytest.raises(ValueError, match="no proposal network"):
        field.proposal_density(torch.zeros(1, 3))


def test_a_single_bin_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="at least 2"):
        RadianceField(SPEC.model_copy(update={"density_bins": 1}), 0)
