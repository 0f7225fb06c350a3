import numpy as np
import pytest
import torch

from inpaint3d.radiance.volume import alpha_weights, median_distance


def evenly(rays: int, n: int, far: float = 1.0, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.linspace(0, far, n + 1, dtype=dtype).expand(rays, n + 1)


def slow_weights(density: np.ndarray, tdist: np.ndarray) -> np.ndarray:
    """NeRF, eq. 3, interval by interval in float64."""
    weights = np.zeros_like(density)
    for ray in range(len(density)):
        transmittance = 1.0
        for i in range(density.shape[1]):
            through = np.exp(-density[ray, i] * (tdist[ray, i + 1] - tdist[ray, i]))
            weights[ray, i] = transmittance * (1 - through)
            transmittance *= through
    return weights


def test_constant_fog_absorbs_exponentially() -> None:
    tdist = evenly(1, 8, far=2.0, dtype=torch.float64)
    weights = alpha_weights(torch.full((1, 8), 0.7, dtype=torch.float64), tdist)
    torch.testing.assert_close(weights.sum(), torch.tensor(1 - np.exp(-1.4)))
    expected = torch.exp(-0.7 * tdist[0, :-1]) - torch.exp(-0.7 * tdist[0, 1:])
    torch.testing.assert_close(weights[0], expected)


def test_equal_to_the_slow_sum() -> None:
    generator = torch.Generator().manual_seed(0)
    density = torch.rand(5, 12, generator=generator, dtype=torch.float64) * 10
    tdist = torch.cumsum(torch.rand(5, 13, generator=generator, dtype=torch.float64), -1)
    torch.testing.assert_close(
        alpha_weights(density, tdist), torch.from_numpy(slow_weights(density.numpy(), tdist.numpy()))
    )


@pytest.mark.parametrize("exponent", range(-38, 39, 4))
def test_any_density_gives_finite_weights_that_sum_to_at_most_one(exponent: int) -> None:
    density = torch.full((3, 16), 10.0**exponent).requires_grad_()
    weights = alpha_weights(density, evenly(3, 16))
    weights.sum().backward()
    assert density.grad is not None
    assert torch.isfinite(weights).all()
    assert torch.isfinite(density.grad).all()
    assert (weights >= 0).all()
    # 16 additions round by up to 16 half steps
    assert weights.sum(-1).max() <= 1 + 16 * torch.finfo(torch.float32).eps / 2


def test_thin_fog_is_kept() -> None:
    # 1 - exp(-1e-9) is 0 in float32
    weights = alpha_weights(torch.full((1, 4), 4e-9), evenly(1, 4))
    torch.testing.assert_close(weights, torch.full((1, 4), 1e-9))


def test_fog_in_front_of_an_opaque_wall_is_kept() -> None:
    # cumsum(x) - x gives 0 for what is in front of 1e12
    density = torch.tensor([[0.5, 0.5, 4e12, 0.0]])
    weights = alpha_weights(density, evenly(1, 4, far=4.0))
    before = float(np.exp(-1.0))
    torch.testing.assert_close(weights, torch.tensor([[1 - np.exp(-0.5), np.exp(-0.5) - before, before, 0.0]]).float())


def test_gradient() -> None:
    generator = torch.Generator().manual_seed(1)
    density = torch.rand(2, 6, generator=generator, dtype=torch.float64).requires_grad_()
    tdist = torch.cumsum(torch.rand(2, 7, generator=generator, dtype=torch.float64), -1).requires_grad_()
    assert torch.autograd.gradcheck(alpha_weights, (density, tdist))


def test_median_lies_where_half_of_the_opacity_is_reached() -> None:
    tdist = torch.tensor([[1.0, 2.0, 3.0, 4.0]])
    half_way = median_distance(torch.tensor([[0.2, 0.4, 0.2]]), tdist, far=9.0, smallest=1e-3)
    torch.testing.assert_close(half_way, torch.tensor([2.5]))
    assert median_distance(torch.zeros(1, 3), tdist, far=9.0, smallest=1e-3) == 9


def test_median_keeps_to_one_surface_where_the_mean_falls_between_two() -> None:
    weights = torch.zeros(1, 100)
    weights[0, 10], weights[0, 90] = 0.6, 0.4
    median = median_distance(weights, evenly(1, 100), far=9.0, smallest=1e-3)
    assert 0.10 <= float(median) <= 0.11
