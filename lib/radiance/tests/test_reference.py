import numpy as np
import pytest
import torch

from inpaint3d.radiance import backends
from inpaint3d.radiance.architecture import Level, levels_of
from inpaint3d.radiance.backends import reference
from inpaint3d.radiance.backends.reference import AdamStep

LEVELS = levels_of(levels=4, coarsest=4, finest=32, log2_table=10)


def seeded(*shape: int, seed: int = 0, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def entries(levels: tuple[Level, ...]) -> int:
    return levels[-1].offset + levels[-1].size


def hashed(i: int, j: int, k: int, size: int) -> int:
    """Instant-NGP's hash in 32-bit arithmetic."""
    x = np.array([i, j, k], np.uint32) * np.array([1, 2654435761, 805459861], np.uint32)
    return int((x[0] ^ x[1] ^ x[2]) % np.uint32(size))


def slow_encode(point: np.ndarray, table: np.ndarray, levels: tuple[Level, ...]) -> np.ndarray:
    """Vertex by vertex."""
    features = []
    for level in levels:
        scaled = point * level.resolution
        low = np.clip(np.floor(scaled), 0, level.resolution - 1).astype(int)
        total = np.zeros(table.shape[1])
        for corner in np.ndindex(2, 2, 2):
            vertex = low + np.array(corner)
            weight = np.prod(np.where(corner, scaled - low, 1 - (scaled - low)))
            side = level.resolution + 1
            i, j, k = (int(v) for v in vertex)
            entry = i + side * (j + side * k) if level.dense else hashed(i, j, k, level.size)
            total += weight * table[level.offset + entry]
        features.append(total)
    return np.concatenate(features)


def test_levels_of_the_paper() -> None:
    levels = levels_of(levels=10, coarsest=16, finest=8192, log2_table=21)
    assert [level.resolution for level in levels] == [16 * 2**i for i in range(10)]
    # 65^3 and 128^3 do not differ in kind: dense while (resolution + 1)^3 fits 2^21 = 128^3
    assert [level.dense for level in levels] == [True, True, True] + [False] * 7
    assert all(level.size == ((level.resolution + 1) ** 3 if level.dense else 2**21) for level in levels)
    assert [level.offset for level in levels] == [0, *np.cumsum([level.size for level in levels])[:-1]]


def test_one_level_is_the_coarsest() -> None:
    assert levels_of(1, 16, 64, 20) == (Level(16, 0, 17**3, True),)


def test_encoding_equals_the_slow_one() -> None:
    table = seeded(entries(LEVELS), 2)
    points = torch.cat([seeded(30, 3, seed=1), torch.tensor([[0.0, 0, 0], [1, 1, 1], [0.25, 0.5, 1]])])
    expected = np.stack([slow_encode(p, table.numpy(), LEVELS) for p in points.numpy()])
    torch.testing.assert_close(reference.hash_encode(points, table, LEVELS), torch.from_numpy(expected))


def test_finest_level_of_the_paper_hashes_as_32_bits_do() -> None:
    level = Level(resolution=8192, offset=0, size=2**21, dense=False)
    points = torch.tensor([[1.0, 1.0, 1.0], [0.7, 0.9, 0.3]], dtype=torch.float64)
    found, _ = reference.corners(points.T.contiguous(), level)
    for column, point in enumerate(points.numpy()):
        low = np.clip(np.floor(point * 8192), 0, 8191).astype(int)
        expected = [hashed(low[0] + i, low[1] + j, low[2] + k, 2**21) for k in (0, 1) for j in (0, 1) for i in (0, 1)]
        assert found[:, column].tolist() == expected


def test_a_linear_function_is_interpolated_exactly() -> None:
    levels = levels_of(2, 4, 8, 12)
    assert all(level.dense for level in levels)
    parts = []
    for level in levels:
        axis = torch.arange(level.resolution + 1, dtype=torch.float64) / level.resolution
        z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
        parts.append((1 + 2 * x - 3 * y + 0.5 * z).reshape(-1, 1))
    points = seeded(50, 3)
    features = reference.hash_encode(points, torch.cat(parts), levels)
    expected = 1 + points @ torch.tensor([2.0, -3.0, 0.5], dtype=torch.float64)
    torch.testing.assert_close(features, expected[:, None].expand(50, 2))


def test_encoding_gradients() -> None:
    # kept off the cells' borders, where the interpolation has a kink
    points = (torch.floor(seeded(4, 3, seed=2) * 32) + 0.1 + 0.8 * seeded(4, 3, seed=3)) / 33
    table = seeded(entries(LEVELS), 2)

    def encode(points: torch.Tensor, table: torch.Tensor) -> torch.Tensor:
        return reference.hash_encode(points, table, LEVELS)

    assert torch.autograd.gradcheck(encode, (points.requires_grad_(), table.requires_grad_()))


def test_colliding_vertices_add_their_gradients() -> None:
    levels = (Level(resolution=64, offset=0, size=16, dense=False),)
    table = torch.zeros(16, 1, dtype=torch.float64, requires_grad=True)
    reference.hash_encode(seeded(200, 3), table, levels).sum().backward()
    assert table.grad is not None
    # trilinear weights of a point sum to 1
    torch.testing.assert_close(table.grad.sum(), torch.tensor(200.0, dtype=torch.float64))


def test_mlp_is_the_layers_written_out() -> None:
    weights = [seeded(8, 5) - 0.5, seeded(8, 8, seed=1) - 0.5, seeded(3, 8, seed=2) - 0.5]
    x = seeded(10, 5, seed=6) - 0.5
    hidden = ((x @ weights[0].T).clamp(min=0) @ weights[1].T).clamp(min=0)
    torch.testing.assert_close(reference.mlp(x, weights), hidden @ weights[2].T)


def test_mlp_starts_are_inputs_that_a_run_of_rows_shares() -> None:
    own, shared = seeded(10, 5, seed=6) - 0.5, seeded(2, 3, seed=4) - 0.5
    first, last = seeded(8, 8) - 0.5, seeded(3, 8, seed=1) - 0.5
    together = torch.cat([own, shared.repeat_interleave(5, 0)], 1)
    apart = reference.mlp(own, [first[:, :5], last], shared @ first[:, 5:].T)
    torch.testing.assert_close(apart, reference.mlp(together, [first, last]))


def test_composite_adds_what_the_weights_say() -> None:
    density, rgb = seeded(3, 6) * 5, seeded(3, 6, 3, seed=1)
    tdist = torch.cumsum(seeded(3, 7, seed=2), -1)
    weights, colour, opacity, depth = reference.composite(density, rgb, tdist)
    torch.testing.assert_close(colour, torch.einsum("rs,rsc->rc", weights, rgb))
    torch.testing.assert_close(opacity, 1 - torch.exp(-(density * torch.diff(tdist)).sum(-1)))
    torch.testing.assert_close(depth, (weights * (tdist[:, 1:] + tdist[:, :-1]) / 2).sum(-1))


def test_an_opaque_interval_gives_its_own_colour_and_middle() -> None:
    density = torch.tensor([[0.0, 1e6, 3.0]])
    rgb = torch.tensor([[[0.1, 0.1, 0.1], [0.2, 0.5, 0.9], [1.0, 1.0, 1.0]]])
    _, colour, opacity, depth = reference.composite(density, rgb, torch.tensor([[1.0, 2.0, 4.0, 5.0]]))
    torch.testing.assert_close(colour, rgb[:, 1])
    assert (opacity, depth) == (1, 3)


def test_resampling_even_weights_gives_even_intervals() -> None:
    ends = reference.resample(torch.tensor([[0.0, 1.0]]), torch.ones(1, 1), 8)
    torch.testing.assert_close(ends, torch.linspace(0, 1, 9)[None])


def test_resampling_follows_the_histogram() -> None:
    sdist = torch.tensor([[0.0, 0.2, 0.5, 0.6, 1.0]], dtype=torch.float64)
    weights = torch.tensor([[0.1, 0.0, 0.6, 0.3]], dtype=torch.float64)
    ends = reference.resample(sdist, weights, 20_000)
    centres = (ends[:, 1:] + ends[:, :-1]) / 2
    share = torch.histogram(centres[0], sdist[0])[0] / 20_000
    torch.testing.assert_close(share, weights[0], atol=1e-3, rtol=0)  # 20,000 centres, one or two at each border


@pytest.mark.parametrize("jittered", [False, True])
@pytest.mark.parametrize("scale", [0.0, 1e-38, 1e-20, 1e-6, 1.0])
def test_resampled_ends_are_sorted_and_inside(scale: float, jittered: bool) -> None:
    sdist = torch.sort(seeded(64, 17, dtype=torch.float32), -1)[0]
    weights = seeded(64, 16, seed=1, dtype=torch.float32) ** 8 * scale / 16
    jitter = seeded(64, 24, seed=2, dtype=torch.float32) if jittered else None
    ends = reference.resample(sdist, weights, 24, jitter)
    assert torch.isfinite(ends).all()
    assert (torch.diff(ends) >= 0).all()
    assert (ends[:, 0] >= sdist[:, 0]).all()
    assert (ends[:, -1] <= sdist[:, -1]).all()


def test_no_jitter_leaves_the_histogram() -> None:
    ends = reference.resample(torch.linspace(0, 1, 5)[None], torch.ones(1, 4), 3, torch.tensor([[-5.0, 0.5, 9.0]]))
    torch.testing.assert_close(ends, torch.tensor([[0.0, 0.25, 0.75, 1.0]]), rtol=0, atol=1e-6)


def test_a_histogram_with_all_its_weight_in_one_interval_puts_the_centres_there() -> None:
    weights = torch.zeros(1, 10)
    weights[0, 6] = 1
    ends = reference.resample(torch.linspace(0, 1, 11)[None], weights, 16)
    assert ends.min() >= 0.6
    assert ends.max() <= 0.7


def test_a_single_interval_is_refused() -> None:
    with pytest.raises(ValueError, match="at least 2"):
        reference.resample(torch.tensor([[0.0, 1.0]]), torch.ones(1, 1), 1)


def test_adam_is_torchs() -> None:
    ours = seeded(50, dtype=torch.float64)
    theirs = ours.clone().requires_grad_()
    m, v = torch.zeros_like(ours), torch.zeros_like(ours)
    optimizer = torch.optim.Adam([theirs], lr=0.01, betas=(0.9, 0.99), eps=1e-15)
    for step in range(1, 30):
        gradient = seeded(50, seed=step) - 0.5
        theirs.grad = gradient.clone()
        optimizer.step()
        reference.adam_step(ours, gradient, m, v, AdamStep(step, 0.01, 0.9, 0.99, 1e-15))
    torch.testing.assert_close(ours, theirs.detach())


@pytest.mark.parametrize("exponent", range(-38, 19, 4))
def test_adam_moves_by_at_most_its_rate_at_first(exponent: int) -> None:
    x, m, v = torch.zeros(2), torch.zeros(2), torch.zeros(2)
    gradient = torch.tensor([1.0, -1.0]) * 10.0**exponent
    reference.adam_step(x, gradient, m, v, AdamStep(1, 0.01, 0.9, 0.99, 1e-15))
    assert torch.isfinite(x).all()
    assert x.abs().max() <= 0.01 * (1 + 1e-5)
    assert (x * gradient <= 0).all()


def test_adam_leaves_alone_what_a_step_would_make_infinite() -> None:
    """Its second moment is finite; the number itself would not be."""
    param, grad = torch.tensor([3e38, 1.0]), torch.tensor([-1.0, -1.0])
    m, v = torch.zeros(2), torch.zeros(2)
    skipped = reference.adam_step(param, grad, m, v, AdamStep(step=1, lr=1e38, beta1=0.0, beta2=0.99, eps=1e-15))
    assert int(skipped) == 1
    assert param[0] == torch.tensor(3e38)
    assert param[1] == torch.tensor(1e38)
    assert m[0] == 0


def test_an_interval_of_no_width_is_bounded_by_nothing() -> None:
    """Where the other histogram has one of no width too, the difference of its sums is negative."""
    other_ends, other = torch.tensor([[0.0, 0.5, 0.5, 1.0]]), torch.tensor([[0.2, 0.3, 0.5]])
    assert reference.outer_measure(torch.tensor([[0.5, 0.5]]), other_ends, other).item() == 0.0


def test_what_lies_on_the_cubes_far_side_is_in_its_last_cell() -> None:
    density = torch.zeros(8)
    cube = torch.tensor([[1.0, 1.0, 1.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    reference.grid_learn(density, 2, cube, torch.tensor([7.0, 1.0, 2.0]), 0.9)
    assert density.tolist() == [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 7.0]


def test_no_point_has_no_feature_and_no_colour() -> None:
    nothing = torch.zeros(0, 3)
    assert reference.mlp(nothing, [torch.ones(4, 3), torch.ones(2, 4)], torch.zeros(0, 4)).shape == (0, 2)
    assert [part.shape for part in reference.colours(nothing, None, torch.zeros(0, 6))] == [(0, 3), (0, 3)]


def test_backends_are_chosen_by_name_or_device() -> None:
    assert backends.select("cpu", "reference") is reference
    assert backends.name_of(backends.select("cpu", "reference")) == "reference"
