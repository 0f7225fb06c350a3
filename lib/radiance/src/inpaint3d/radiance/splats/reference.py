"""Splatting as one reads it: every splat at every pixel. Memory is splats times pixels, so that it is for tests and for
machines without kernels, a strip of rows at a time.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.radiance.splats.model import NEAR, Splats, View

LOW_PASS = 0.3  # px^2 on the variances in the picture: nothing is thinner than a pixel
FAINTEST = 1 / 255  # where a splat ends
MOST_OPAQUE = 0.99
DARKEST = 1e-4  # light that is left, below which a pixel takes no more splats
SIDEWAYS = 1.3  # half pictures from whose middle on the affine approximation is held
PAIRS = 1 << 22  # splats times pixels at once


def rotation_matrices(quaternion: Float[Tensor, "n 4"]) -> Float[Tensor, "n 3 3"]:
    """Rotations of quaternions w, x, y, z of any length."""
    w, x, y, z = (quaternion / quaternion.norm(dim=1, keepdim=True)).unbind(1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, -1) for row in rows], -2)


def covariances(splats: Splats) -> Float[Tensor, "n 3 3"]:
    """R S S^T R^T (arXiv:2308.04079, eq. 6), squared scene units."""
    root = rotation_matrices(splats.rotation) * splats.log_scale.exp()[:, None, :]
    return root @ root.mT


def project(splats: Splats, view: View) -> tuple[Tensor, Tensor, Tensor]:
    """Centres in pixels [n, 2], covariances in the picture [n, 2, 2] (eq. 5), depths along the axis [n]."""
    fx, fy, cx, cy = view.intrinsics
    world = view.cam_from_world.to(splats.mean)
    at = splats.mean @ world[:, :3].T + world[:, 3]
    x, y, z = at.unbind(1)
    far_x, far_y = SIDEWAYS * view.width / 2 / fx, SIDEWAYS * view.height / 2 / fy
    middle_x, middle_y = (view.width / 2 - cx) / fx, (view.height / 2 - cy) / fy
    u = (x / z).clamp(middle_x - far_x, middle_x + far_x)
    v = (y / z).clamp(middle_y - far_y, middle_y + far_y)
    nought = torch.zeros_like(z)
    jacobian = torch.stack(
        [torch.stack([fx / z, nought, -fx * u / z], -1), torch.stack([nought, fy / z, -fy * v / z], -1)], -2
    )
    to_picture = jacobian @ world[:, :3]
    covariance = to_picture @ covariances(splats) @ to_picture.mT + LOW_PASS * torch.eye(2).to(z)
    return torch.stack([fx * x / z + cx, fy * y / z + cy], -1), covariance, z


def render_splats(splats: Splats, view: View) -> Float[Tensor, "h w 3"]:
    """Blend splats front to back at every pixel's centre (eqs. 3 and 4), before black."""
    centre, covariance, z = project(splats, view)
    order = torch.argsort(torch.where(z >= NEAR, z, torch.inf), stable=True)[: int((z >= NEAR).sum())]
    centre, precision = centre[order], torch.linalg.inv(covariance[order])
    opacity, rgb = splats.opacity[order].sigmoid(), splats.rgb[order]
    rows = max(1, PAIRS // max(1, len(order) * view.width))
    strips = [
        _render_rows(range(top, min(top + rows, view.height)), view.width, centre, precision, opacity, rgb)
        for top in range(0, view.height, rows)
    ]
    return torch.cat(strips)


def _render_rows(
    rows: range, width: int, centre: Tensor, precision: Tensor, opacity: Tensor, rgb: Tensor
) -> Float[Tensor, "rows w 3"]:
    y, x = torch.meshgrid(torch.tensor([*rows]) + 0.5, torch.arange(width) + 0.5, indexing="ij")
    away = torch.stack([x, y], -1).to(centre).reshape(-1, 1, 2) - centre
    exponent = -0.5 * torch.einsum("pni,nij,pnj->pn", away, precision, away)
    alpha = opacity * exponent.exp()
    alpha = torch.where(alpha >= FAINTEST, alpha.clamp(max=MOST_OPAQUE), 0.0)
    before = torch.cat([torch.ones_like(alpha[:, :1]), torch.cumprod(1 - alpha, 1)[:, :-1]], 1)
    # Light only lessens, so that what is dropped once it is dark leaves the light before it as it was.
    weights = alpha * before * (before > DARKEST)
    return (weights @ rgb).reshape(len(rows), width, 3)
