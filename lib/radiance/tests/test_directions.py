import numpy as np
import torch

from inpaint3d.radiance.architecture import DIRECTION_COMPONENTS
from inpaint3d.radiance.directions import spherical_harmonics


def test_orthonormal_on_the_sphere() -> None:
    # Gauss-Legendre in z times even steps in azimuth integrates polynomials of degree 6 exactly.
    z, z_weight = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * (2 * np.pi / 16)
    zz, aa = (grid.ravel() for grid in np.meshgrid(z, azimuth, indexing="ij"))
    flat = np.sqrt(1 - zz**2)
    directions = torch.from_numpy(np.stack([flat * np.cos(aa), flat * np.sin(aa), zz], -1))
    weights = torch.from_numpy(np.repeat(z_weight, 16) * (2 * np.pi / 16))
    values = spherical_harmonics(directions)
    assert values.shape[1] == DIRECTION_COMPONENTS
    torch.testing.assert_close((values * weights[:, None]).T @ values, torch.eye(16, dtype=torch.float64))


def test_degree_is_parity() -> None:
    direction = torch.nn.functional.normalize(torch.tensor([[0.3, -0.5, 0.8]]), dim=-1)
    there, back = spherical_harmonics(direction)[0], spherical_harmonics(-direction)[0]
    degree = torch.tensor([0, *[1] * 3, *[2] * 5, *[3] * 7])
    torch.testing.assert_close(back, there * (-1.0) ** degree)
