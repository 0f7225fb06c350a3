"""Score distillation: which way a rendered patch should move so that the prior believes it (conformance S2 to S9).

All functions return gradients with respect to the patch x in [-1, 1]; a caller multiplies by dx/dtheta by handing them
to autograd: `patch.backward(gradient)`. Nothing flows through the prior or through its condition, on purpose.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from inpaint3d.diffusion.prior import Image, InpaintingPrior, Mask, Times
from inpaint3d.diffusion.samplers import ddim
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

T_FLOOR = 0.02
"""t never falls below this: nearer 0 the noise is under one code value of a photo and the gradient means nothing."""


@torch.no_grad()
def sds_gradient(
    prior: InpaintingPrior,
    x: Image,
    mask: Mask,
    t: Times,
    eps: Image,
    *,
    guidance: float = 1.0,
    noise_fill: Image | None = None,
) -> Image:
    """w(t) (eps_hat(z_t; t, y) - eps) M, with w = sigma(t)^2 (DreamFusion, arXiv:2209.14988, eq. 3; S2 to S4).

    The condition y is the rendered patch itself outside the hole, (1 - M) x.
    """
    x = x.detach()
    a, s = _levels(t)
    z = a * x + s * eps
    # The denoiser's Jacobian is dropped on purpose: that is SDS.
    eps_hat = prior.predict_noise(z, t, x, mask, guidance=guidance, noise_fill=noise_fill)
    return s**2 * (eps_hat - eps) * mask


@torch.no_grad()
def denoised_target_gradient(
    prior: InpaintingPrior,
    x: Image,
    mask: Mask,
    t: Times,
    eps: Image,
    *,
    guidance: float = 1.0,
    noise_fill: Image | None = None,
    steps: int = 4,
) -> Image:
    """(x - x_hat) M, where x_hat is x noised to t and denoised by DDIM in `steps` steps.

    The multi-step target of SparseFusion (arXiv:2212.00792) and ReconFusion (arXiv:2312.02981):
    the gradient of half the squared distance to x_hat. SDS is the same direction with steps = 1 and weight
    alpha(t) sigma(t) (x - x_hat = (eps_hat - eps) sigma / alpha); more steps make x_hat one sharp picture instead of
    the mean of many, and a gradient whose size does not depend on t.
    """
    return (
        x.detach() - denoised_target(prior, x, mask, t, eps, guidance=guidance, noise_fill=noise_fill, steps=steps)
    ) * mask


@torch.no_grad()
def denoised_target(
    prior: InpaintingPrior,
    x: Image,
    mask: Mask,
    t: Times,
    eps: Image,
    *,
    guidance: float = 1.0,
    noise_fill: Image | None = None,
    steps: int = 4,
) -> Image:
    """The patch noised to t and denoised again, in [-1, 1] inside the hole (SDEdit, arXiv:2108.01073); x outside it."""
    x = x.detach()
    a, s = _levels(t)

    def predict(z: Tensor, level: Tensor) -> Tensor:
        return prior.predict_noise(z, level, x, mask, guidance=guidance, noise_fill=noise_fill)

    # Each image starts from its own t, so that times are [steps + 1, b].
    times = torch.linspace(1, 0, steps + 1).to(t)[:, None] * t
    target = ddim(predict, a * x + s * eps, times, clip=1.0)
    return torch.where(mask > 0, target.clamp(-1, 1), x)


def t_range(step: int, total: int) -> tuple[float, float]:
    """(lowest, highest) t of a step (S9): U(eta - 0.2, eta) with eta = max(0.2, 0.95 (1 - step / total))."""
    eta = max(0.2, 0.95 * (1 - step / total))
    return max(T_FLOOR, eta - 0.2), eta


def sample_t(step: int, total: int, count: int, generator: torch.Generator) -> Float[Tensor, "b"]:
    """Fresh noise levels, one per view (S3, S9)."""
    low, high = t_range(step, total)
    return low + (high - low) * torch.rand(count, generator=generator)


def _levels(t: Times) -> tuple[Tensor, Tensor]:
    return per_image(alpha(t)), per_image(sigma(t))
