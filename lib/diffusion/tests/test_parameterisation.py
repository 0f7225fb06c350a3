from typing import get_args

import pytest
import torch

from inpaint3d.diffusion.bands import band_filter, from_opponent
from inpaint3d.diffusion.parameterisation import Kind, Parameterisation
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

KINDS = get_args(Kind)
BANDS = (0.1, 0.25, 0.6)
COLOURS = (1.0, 0.3, 0.15)
T = torch.tensor([0.02, 0.2, 0.5, 0.8, 0.98], dtype=torch.float64)


def _draw(seed: int, count: int = 3) -> list[torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(5, 3, 8, 8, generator=generator, dtype=torch.float64) for _ in range(count)]


@pytest.mark.parametrize("kind", KINDS)
def test_the_target_names_picture_and_noise_exactly(kind: Kind) -> None:
    x, eps, fill = _draw(0)
    parameterisation = Parameterisation(kind, T, BANDS, COLOURS)
    a, s = parameterisation.levels
    output = parameterisation.target(x, eps, fill)
    torch.testing.assert_close(parameterisation.clean(output, a * x + s * eps, fill), x)
    torch.testing.assert_close(parameterisation.noise(output, a * x + s * eps, fill), eps)


@pytest.mark.parametrize("kind", KINDS)
def test_any_output_splits_z_into_picture_and_noise(kind: Kind) -> None:
    output, z, fill = _draw(1)
    parameterisation = Parameterisation(kind, T, BANDS, COLOURS)
    a, s = parameterisation.levels
    clean, noise = parameterisation.clean(output, z, fill), parameterisation.noise(output, z, fill)
    torch.testing.assert_close(a * clean + s * noise, z)


@pytest.mark.parametrize("t", [0.0, 1e-6, 1e-3, 0.999, 1.0])
def test_the_residuals_noise_stays_exact_where_sigma_or_alpha_vanish(t: float) -> None:
    x, eps, fill = (value.float() for value in _draw(2))
    parameterisation = Parameterisation("residual", torch.full((5,), t), BANDS, COLOURS)
    a, s = parameterisation.levels
    output = parameterisation.target(x, eps, fill)
    torch.testing.assert_close(parameterisation.clean(output, a * x + s * eps, fill), x, rtol=0, atol=1e-5)
    # z = a x + s eps itself rounds eps to float32's 6e-8 over s.
    exact = max(1e-5, 1e-6 / s.min().item())
    torch.testing.assert_close(parameterisation.noise(output, a * x + s * eps, fill), eps, rtol=0, atol=exact)


def test_residual_with_no_fill_and_unit_spread_is_minus_v() -> None:
    x, eps, _ = _draw(3)
    v = Parameterisation("v", T, (), COLOURS).target(x, eps, x)
    residual = Parameterisation("residual", T, (1.0,), (1.0, 1.0, 1.0)).target(x, eps, torch.zeros_like(x))
    torch.testing.assert_close(residual, -v)


def test_the_linear_guess_is_the_posterior_mean_of_a_gaussian_about_the_fill() -> None:
    z, fill = _draw(4, 2)
    a, s = per_image(alpha(T)), per_image(sigma(T))
    # Precision-weighted mean of the prior N(fill, d^2) and the observation z / a, which is N(x, (s / a)^2).
    posterior = (fill / 0.3**2 + z * a / s**2) / (1 / 0.3**2 + (a / s) ** 2)
    torch.testing.assert_close(
        Parameterisation("residual", T, (0.3,), (1.0, 1.0, 1.0)).linear_guess(z, fill), posterior
    )


def test_the_linear_guess_is_the_best_for_pictures_of_its_own_bands() -> None:
    generator = torch.Generator().manual_seed(5)
    x, eps = _of_the_bands(generator), torch.randn(5, 3, 128, 128, generator=generator)
    t = torch.tensor([0.1, 0.2, 0.4, 0.6, 0.8])
    z = per_image(alpha(t)) * x + per_image(sigma(t)) * eps
    errors = [
        (Parameterisation("residual", t, bands, colours).linear_guess(z, torch.zeros_like(x)) - x)
        .square()
        .mean((1, 2, 3))
        for bands, colours in (
            (BANDS, COLOURS),
            ((0.2, 0.25, 0.6), COLOURS),
            ((0.1, 0.25, 0.3), COLOURS),
            ((0.2,), COLOURS),
            (BANDS, (1.0, 1.0, 1.0)),
            (BANDS, (1.0, 0.15, 0.3)),
        )
    ]
    assert all((errors[0] < other).all() for other in errors[1:])


def test_the_residual_target_has_unit_variance_at_every_noise_level() -> None:
    generator = torch.Generator().manual_seed(6)
    x, eps = _of_the_bands(generator), torch.randn(5, 3, 128, 128, generator=generator)
    target = Parameterisation("residual", T.float(), BANDS, COLOURS).target(x, eps, torch.zeros_like(x))
    # 49,152 samples: the variance is known to 0.7 %.
    torch.testing.assert_close(target.var(dim=(1, 2, 3)), torch.ones(5), rtol=0, atol=0.03)


def _of_the_bands(generator: torch.Generator) -> torch.Tensor:
    """Pictures [5, 3, 128, 128] whose opponent colours have the spreads BANDS x COLOURS."""
    spreads = torch.outer(torch.tensor(BANDS), torch.tensor(COLOURS)).expand(5, 3, 3)
    return from_opponent(band_filter(torch.randn(5, 3, 128, 128, generator=generator), spreads))
