"""Directions as spherical harmonics, for view-dependent colour."""

import torch
from jaxtyping import Float
from torch import Tensor


def spherical_harmonics(directions: Float[Tensor, "n 3"]) -> Float[Tensor, "n 16"]:
    """The real orthonormal harmonics of degrees 0 to 3 of unit directions, by degree, then order."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),  # 1/2 sqrt(1/pi)
            0.4886025119029199 * y,  # sqrt(3/(4 pi))
            0.4886025119029199 * z,
            0.4886025119029199 * x,
            1.0925484305920792 * x * y,  # 1/2 sqrt(15/pi)
            1.0925484305920792 * y * z,
            0.31539156525252005 * (3 * zz - 1),  # 1/4 sqrt(5/pi)
            1.0925484305920792 * x * z,
            0.5462742152960396 * (xx - yy),
            0.5900435899266435 * y * (3 * xx - yy),  # 1/4 sqrt(35/(2 pi))
            2.890611442640554 * x * y * z,  # 1/2 sqrt(105/pi)
            0.4570457994644658 * y * (5 * zz - 1),  # 1/4 sqrt(21/(2 pi))
            0.3731763325901154 * z * (5 * zz - 3),  # 1/4 sqrt(7/pi)
            0.4570457994644658 * x * (5 * zz - 1),
            1.445305721320277 * z * (xx - yy),
            0.5900435899266435 * x * (xx - 3 * yy),
        ],
        -1,
    )
