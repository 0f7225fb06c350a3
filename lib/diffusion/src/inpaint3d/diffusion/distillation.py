"""Score distillation: which way a rendered patch should move so that the prior believes it (conformance S2 to S9).

All functions return gradients with respect to the patch x in [-1, 1]; a caller multiplies by dx/dtheta by handing them
to autograd: `patch.backward(gradient)`. Nothing flows through the denoiser or through its condition, on purpose.

A prior over an autoencoder's codes is asked about the patch's code; what it answers goes back to pixels through the
transposed Jacobian of the encoder (`_encode`), or as a picture through the decoder.

| function | paper | UNet evaluations, g = 1 | else |
|---|---|---|---|
| sds_gradient | DreamFusion, arXiv:2209.14988 | 1 | 2 |
| nfsd_gradient | noise-free score distillation, arXiv:2310.17590 | 2 | 3 |
| sdi_gradient | DDIM inversion, arXiv:2405.15891 | steps + 1 | steps + 2 |
| ism_gradient | interval score matching, arXiv:2311.11284 | steps + 2 | steps + 3 |
| vsd_gradient | variational score distillation, arXiv:2305.16213 | 2 + learning | 3 + learning |
| denoised_target_gradient | SparseFusion, arXiv:2212.00792 | steps | 2 steps |
| dataset_gradient | iterative dataset update, arXiv:2303.12789 | 0, and `denoised_target` for each update | |
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from inpaint3d.diffusion.denoiser import Denoiser, Image, Latent, Mask, Times, check_answer
from inpaint3d.diffusion.samplers import ddim
from inpaint3d.diffusion.schedules import alpha, per_image, sigma

T_FLOOR = 0.02
"""t never falls below this: nearer 0 the noise is under one code value of a photo and the gradient means nothing."""

NFSD_SPLIT = 0.2
"""Under this t the null estimate points to pictures by itself (NFSD, section 4.1: t < 200 of 1000)."""


class PriorQuery(NamedTuple):
    """What a prior is asked about a rendered patch.

    x: the patch [b, 3, h, w] in [-1, 1]. mask: its hole [b, 1, h, w]. t: diffusion times [b]. eps: N(0, 1) of the
    code's shape, that noises it; gradients that find their noise by inversion need none. noise_fill: what a condition
    that holds noise shows in the hole (D5); None: drawn anew each time.
    """

    x: Image
    mask: Mask
    t: Times
    eps: Latent | None = None
    noise_fill: Image | None = None

    def noise(self, code: Latent) -> tuple[Latent, Latent]:
        """A code at t, and its noise. Raises ValueError without any."""
        if self.eps is None:
            raise ValueError("this gradient noises the patch itself; give the query eps")
        a, s = _compute_levels(self.t)
        return a * code + s * self.eps, self.eps


@torch.no_grad()
def sds_gradient(prior: Denoiser, query: PriorQuery, *, guidance: float = 1.0) -> Image:
    """w(t) (eps_hat(z_t; t, y) - eps) M, with w = sigma(t)^2 (DreamFusion, arXiv:2209.14988, eq. 3; S2 to S4).

    The condition y is the rendered patch itself outside the hole, (1 - M) x.
    """
    x, mask, t = query.x.detach(), query.mask, query.t
    code, to_pixels = _encode(prior, x, mask)
    _, s = _compute_levels(t)
    z, eps = query.noise(code)
    # The denoiser's Jacobian is dropped on purpose: that is SDS.
    eps_hat = check_answer(prior.predict_noise(z, t, x, mask, guidance=guidance, noise_fill=query.noise_fill), t)
    return to_pixels(s**2 * (eps_hat - eps))


@torch.no_grad()
def nfsd_gradient(prior: Denoiser, query: PriorQuery, *, guidance: float = 1.0) -> Image:
    """w(t) (delta_D + g (eps_cond - eps_null)) M (NFSD, arXiv:2310.17590, eq. 9): the noise itself is not in it.

    delta_D, the way to plausible pictures, is eps_null at t < 0.2 and eps_null - eps_negative above, where both hold
    the same noise. A prior without text has no negative prompt: the negative condition is the patch with its known
    pixels smoothed, so that what it leads away from is blur.
    """
    x, mask, t = query.x.detach(), query.mask, query.t
    code, to_pixels = _encode(prior, x, mask)
    _, s = _compute_levels(t)
    z, _ = query.noise(code)
    estimate = check_answer(prior.predict_noise(z, t, x, mask, guidance=guidance, noise_fill=query.noise_fill), t)
    negative = check_answer(prior.predict_noise(z, t, _smooth(x, mask), mask, noise_fill=query.noise_fill), t)
    return to_pixels(s**2 * torch.where(per_image(t) < NFSD_SPLIT, estimate, estimate - negative))


@torch.no_grad()
def sdi_gradient(prior: Denoiser, query: PriorQuery, *, guidance: float = 1.0, steps: int = 4) -> Image:
    """w(t) (eps_hat(z_t; t, y) - kappa) M, kappa the noise that DDIM inversion finds for x (SDI, arXiv:2405.15891).

    Fresh noise asks each step for another picture, and the hole becomes their mean; inverted noise asks for the one
    that x is on the way to. The inversion follows the plain conditional estimate.
    """
    x, mask, t = query.x.detach(), query.mask, query.t
    code, to_pixels = _encode(prior, x, mask)
    a, s = _compute_levels(t)

    def predict(z: Tensor, level: Tensor) -> Tensor:
        return prior.predict_noise(z, level, x, mask, noise_fill=query.noise_fill)

    z = ddim(predict, code, _space_times(torch.full_like(t, T_FLOOR), t, steps))
    eps_hat = check_answer(prior.predict_noise(z, t, x, mask, guidance=guidance, noise_fill=query.noise_fill), t)
    return to_pixels(s**2 * (eps_hat - (z - a * code) / s))


@torch.no_grad()
def ism_gradient(
    prior: Denoiser, query: PriorQuery, *, guidance: float = 1.0, steps: int = 4, interval: float = 0.05
) -> Image:
    """w(t) (eps_hat(z_t; t, y) - eps_null(z_s; s)) M with s = t - interval (ISM, arXiv:2311.11284, eq. 17).

    z_s and z_t lie on one path of DDIM inversion under the null condition, in `steps` steps to s and one to t.
    """
    x, mask, t = query.x.detach(), query.mask, query.t
    code, to_pixels = _encode(prior, x, mask)
    _, weight = _compute_levels(t)
    before = (t - interval).clamp(min=T_FLOOR)

    def null(z: Tensor, level: Tensor) -> Tensor:
        return prior.predict_noise(z, level, x, mask, guidance=0.0, noise_fill=query.noise_fill)

    z_s = ddim(null, code, _space_times(torch.full_like(t, T_FLOOR), before, steps))
    eps_s = check_answer(null(z_s, before), before)
    (a_s, s_s), (a, s) = _compute_levels(before), _compute_levels(t)
    z_t = a * (z_s - s_s * eps_s) / a_s + s * eps_s
    eps_hat = check_answer(prior.predict_noise(z_t, t, x, mask, guidance=guidance, noise_fill=query.noise_fill), t)
    return to_pixels(weight**2 * (eps_hat - eps_s))


@torch.no_grad()
def vsd_gradient(prior: Denoiser, copy: Denoiser, query: PriorQuery, *, guidance: float = 1.0) -> Image:
    """w(t) (eps_hat - eps_copy) M, where the copy has learnt the renders (VSD, arXiv:2305.16213, eq. 9).

    copy: see `low_rank.LowRankCopy`; unlike the paper's it is not told the camera. Once it knows one picture by heart
    this is SDS; as long as it is the prior itself, guidance 1 gives 0.
    """
    x, mask, t = query.x.detach(), query.mask, query.t
    code, to_pixels = _encode(prior, x, mask)
    _, s = _compute_levels(t)
    z, _ = query.noise(code)
    eps_hat = check_answer(prior.predict_noise(z, t, x, mask, guidance=guidance, noise_fill=query.noise_fill), t)
    eps_copy = check_answer(copy.predict_noise(z, t, x, mask, noise_fill=query.noise_fill), t)
    return to_pixels(s**2 * (eps_hat - eps_copy))


@torch.no_grad()
def denoised_target_gradient(prior: Denoiser, query: PriorQuery, *, guidance: float = 1.0, steps: int = 4) -> Image:
    """(x - x_hat) M, where x_hat is x noised to t and denoised by DDIM in `steps` steps.

    The multi-step target of SparseFusion (arXiv:2212.00792) and ReconFusion (arXiv:2312.02981):
    the gradient of half the squared distance to x_hat. SDS is the same direction with steps = 1 and weight
    alpha(t) sigma(t) (x - x_hat = (eps_hat - eps) sigma / alpha); more steps make x_hat one sharp picture instead of
    the mean of many, and a gradient whose size does not depend on t.
    """
    target = denoised_target(prior, query, guidance=guidance, steps=steps)
    return dataset_gradient(query.x, query.mask, target)


def dataset_gradient(x: Image, mask: Mask, target: Image) -> Image:
    """(x - target) M, that of half the squared distance to a picture that stays until it is updated.

    Iterative dataset update (Instruct-NeRF2NeRF, arXiv:2303.12789, section 4.2): the target is the `denoised_target`
    of an earlier render of the same view.
    """
    return (x.detach() - target) * mask


@torch.no_grad()
def denoised_target(prior: Denoiser, query: PriorQuery, *, guidance: float = 1.0, steps: int = 4) -> Image:
    """The patch noised to t and denoised again, in [-1, 1] inside the hole (SDEdit, arXiv:2108.01073); x outside it."""
    x, mask, t = query.x.detach(), query.mask, query.t

    def predict(z: Tensor, level: Tensor) -> Tensor:
        return prior.predict_noise(z, level, x, mask, guidance=guidance, noise_fill=query.noise_fill)

    z, _ = query.noise(prior.encode(x))
    clean = ddim(predict, z, _space_times(t, torch.zeros_like(t), steps), clip=prior.bound)
    return torch.where(mask > 0, check_answer(prior.decode(clean), t).clamp(-1, 1), x)


def _encode(prior: Denoiser, x: Image, mask: Mask) -> tuple[Latent, Callable[[Latent], Image]]:
    """The patch's code, and what turns a gradient with respect to it into that of the hole's pixels.

    The gradient is weighed as of a mean over codes, not over pixels: where an encoder averages, its pixels are pushed
    as they would be without one. Codes that the hole does not touch push nothing.
    """
    with torch.enable_grad():
        x = x.detach().requires_grad_()
        code = prior.encode(x)

    def to_pixels(gradient: Latent) -> Image:
        touched = F.adaptive_max_pool2d(mask, gradient.shape[-2:])
        (pulled,) = torch.autograd.grad(code, x, gradient * touched)
        return pulled * (mask.numel() / touched.numel()) * mask

    return code.detach(), to_pixels


def _compute_levels(t: Times) -> tuple[Tensor, Tensor]:
    return per_image(alpha(t)), per_image(sigma(t))


def _space_times(first: Times, last: Times, steps: int) -> Float[Tensor, "n b"]:
    """Times of `steps` equal steps, from each image's own first to its own last, [steps + 1, b]."""
    share = torch.linspace(0, 1, steps + 1).to(first)[:, None]
    return first + share * (last - first)


def _smooth(x: Image, mask: Mask, side: int = 5) -> Image:
    """Means over squares of `side` pixels, of known pixels alone; 0 where there are none."""
    known = 1 - mask
    total, count = (F.avg_pool2d(part, side, 1, side // 2) for part in (x * known, known))
    return total / count.clamp(min=torch.finfo(x.dtype).eps)
