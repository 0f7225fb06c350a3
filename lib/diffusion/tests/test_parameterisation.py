from typing import get_args

import pytest
import torch

from inpaint3d.diffusion.parameterisation import Prediction, clean_from_output, noise_from_output, target_output
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

KINDS = get_args(Prediction)


def _problem(seed: int = 0) -> tuple[torch.Tensor, ...]:
    generator = torch.Generator().manual_seed(seed)
    x, eps, fill = (torch.randn(5, 3, 4, 4, generator=generator, dtype=torch.float64) for _ in range(3))
    t = torch.tensor([0.02, 0.2, 0.5, 0.8, 0.98], dtype=torch.float64)
    a, s = per_image(alpha(t)), per_image(sigma(t))
    return x, eps, fill, a, s, a * x + s * eps


@pytest.mark.parametrize("kind", KINDS)
def test_the_target_names_picture_and_noise_exactly(kind: Prediction) -> None:
    x, eps, fill, a, s, z = _problem()
    output = target_output(kind, x, eps, a, s, fill, 0.3)
    torch.testing.assert_close(clean_from_output(kind, output, z, a, s, fill, 0.3), x)
    torch.testing.assert_close(noise_from_output(kind, output, z, a, s, fill, 0.3), eps)


@pytest.mark.parametrize("kind", KINDS)
def test_any_output_splits_z_into_picture_and_noise(kind: Prediction) -> None:
    x, _, fill, a, s, z = _problem()
    output = torch.randn(x.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    clean = clean_from_output(kind, output, z, a, s, fill, 0.3)
    noise = noise_from_output(kind, output, z, a, s, fill, 0.3)
    torch.testing.assert_close(a * clean + s * noise, z)


def test_residual_with_no_fill_and_unit_spread_is_v() -> None:
    x, eps, _, a, s, _ = _problem()
    v = target_output("v", x, eps, a, s, x, 1.0)
    residual = target_output("residual", x, eps, a, s, torch.zeros_like(x), 1.0)
    torch.testing.assert_close(residual, -v)


def test_residual_of_zero_is_the_posterior_mean_of_a_gaussian_about_the_fill() -> None:
    _, _, fill, a, s, z = _problem()
    d = 0.3
    # Precision-weighted mean of the prior N(fill, d^2) and the observation z / a ~ N(x, (s / a)^2).
    precision = 1 / d**2 + (a / s) ** 2
    posterior = (fill / d**2 + z * a / s**2) / precision
    torch.testing.assert_close(clean_from_output("residual", torch.zeros_like(z), z, a, s, fill, d), posterior)


def test_residual_target_has_unit_variance_at_every_noise_level() -> None:
    generator = torch.Generator().manual_seed(0)
    t = torch.tensor([0.001, 0.1, 0.5, 0.9, 0.999])
    a, s = per_image(alpha(t)), per_image(sigma(t))
    fill, noise, eps = (torch.randn(5, 3, 100, 100, generator=generator) for _ in range(3))
    target = target_output("residual", fill + 0.3 * noise, eps, a, s, fill, 0.3)
    # 30,000 samples: the variance is known to 1 %.
    torch.testing.assert_close(target.var(dim=(1, 2, 3)), torch.ones(5), rtol=0, atol=0.04)
